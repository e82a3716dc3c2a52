"""A simulated flight in front of a cracking panel, exact in every number: as a bag, and as live sensors."""

from .flight import Flight, FlightSettings, sample_flight_settings
from .flight_bag import FlightSummary, simulate_flight
from .live import SimulatedCamera, SimulatedTof

__all__ = [
    "Flight",
    "FlightSettings",
    "FlightSummary",
    "SimulatedCamera",
    "SimulatedTof",
    "sample_flight_settings",
    "simulate_flight",
]
