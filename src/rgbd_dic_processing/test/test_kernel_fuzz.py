"""The kernel under thousands of random calls, right ones and wrong ones.

Every argument comes with whether it is wrong. A call with a wrong one must raise an error that names it; all others
must return, and what they return must be consistent. RGBD_DIC_FUZZ_CALLS sets the number of calls, RGBD_DIC_FUZZ_SEED
another beginning; a failure names the seed of its call.
"""

from __future__ import annotations

import os
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from rgbd_dic_processing.core.correlation import SubsetStatus
from scipy import ndimage

from rgbd_dic_processing import _kernel

CALLS = int(os.environ.get("RGBD_DIC_FUZZ_CALLS", 5000))
SEED = int(os.environ.get("RGBD_DIC_FUZZ_SEED", 1))
Random = np.random.Generator


@dataclass(frozen=True)
class Argument:
    value: Any
    is_wrong: bool = False


def wrong(value: Any) -> Argument:
    return Argument(value, True)


@pytest.fixture(autouse=True)
def _fastest_instruction_set_afterwards():
    yield
    _kernel.use_instruction_set(_kernel.instruction_sets()[0])


# Arguments


def unusual_layout(random: Random, array: np.ndarray) -> Argument:
    """The same numbers, laid out in memory in another way; wrong unless they happen to be in a row all the same."""
    kind = random.integers(5)
    if kind == 0:
        array = np.asfortranarray(array)
    elif kind == 1:
        array = np.repeat(array, 2, axis=0)[::2]
    elif kind == 2:
        array = np.repeat(array, 2, axis=-1)[..., ::2]
    elif kind == 3:
        array = np.flip(np.flip(array).copy())
    else:
        unaligned = np.empty(array.nbytes + 1, np.uint8)[1:].view(array.dtype).reshape(array.shape)
        unaligned[...] = array
        array = unaligned
    return Argument(array, not (array.flags.c_contiguous and array.flags.aligned))


def unusual_array(random: Random, array: np.ndarray) -> Argument:
    """Of another type, shape or layout."""
    kind = random.integers(4)
    if kind == 0:
        types = [np.float16, np.int64, np.uint32, np.bool_, np.complex64, object, array.dtype.newbyteorder()]
        with np.errstate(all="ignore"):
            other = array.astype(types[random.integers(len(types))])
        return Argument(other, other.dtype != array.dtype)  # a byte has no order
    if kind == 1:
        return wrong(
            [array[None], array[..., None], array.ravel(), array.ravel()[:1].sum(keepdims=False)][
                random.integers(4 if array.ndim > 1 else 2)
            ]
        )
    if kind == 2:
        return wrong([None, "image", 7, array.tolist()][random.integers(4)])
    return unusual_layout(random, array)


def pattern(random: Random, rows: int, cols: int) -> np.ndarray:
    """Grey values with much, little or no texture."""
    kind = random.integers(12)
    y, x = np.mgrid[:rows, :cols]
    if kind == 0:
        return np.full((rows, cols), random.choice([0.0, 128.0, 255.0]))
    if kind == 1:
        return 127.0 * ((x // random.integers(1, 5)) % 2)
    if kind == 2:
        return (x + 2.0 * y) % 256
    if kind == 3:
        return 255.0 * ((x == cols // 2) & (y == rows // 2))
    if kind == 4:
        return random.uniform(0, 255, (rows, cols))
    speckle = ndimage.gaussian_filter(random.normal(0, 1, (rows, cols)), 1.5)
    return np.clip(128 + 250 * speckle, 0, 255)


def image(random: Random, grey: np.ndarray) -> Argument:
    """Grey values as an image of the kernel, seldom a wrong one."""
    too_small = min(grey.shape) < 8
    kind = random.integers(20)
    if kind < 9:
        return Argument(grey.astype(np.uint8), too_small)
    grey = grey.astype(np.float32)
    if kind == 9:
        grey *= np.float32(10.0) ** random.integers(-44, 36)
    elif kind == 10:
        grey += np.float32(10.0) ** random.integers(3, 38)
    elif kind == 11 and grey.size:
        grey.flat[random.integers(grey.size)] = random.choice([np.nan, np.inf, -np.inf])
        return wrong(grey)
    elif kind == 12:
        unusual = unusual_array(random, grey)
        return Argument(unusual.value, unusual.is_wrong or too_small)
    return Argument(grey, too_small)


def length(random: Random) -> int:
    """Of a side of an image, px."""
    return int(
        random.choice([random.integers(0, 12), random.integers(8, 120), random.integers(40, 301)], p=[0.05, 0.75, 0.2])
    )


def whole_number(random: Random, low: int, high: int, good: list[int]) -> Argument:
    """Mostly one of the good ones; otherwise anything, wrong if below low or above high, or not a whole number."""
    if random.random() < 0.95:
        return Argument(int(random.choice(good)))
    value = [low - 1, high + 1, -(2**31), 2**31 - 1, 2**40, 1.5, "3", None][random.integers(8)]
    return wrong(value)


def real_number(random: Random, low: float, high: float, good: list[float]) -> Argument:
    if random.random() < 0.97:
        return Argument(float(random.choice(good)))
    value = random.choice([np.nan, np.inf, -np.inf, -1e-3, 0.0, 1e300])
    return Argument(value, not low <= value <= high)


def centres(random: Random, rows: int, cols: int) -> Argument:
    """Points to be followed: most inside the image, at pixels or between, some outside, NaN or far away."""
    count = int(random.choice([0, 1, 5, 40, 100]))
    margin = random.choice([0, 0.2, 0.2])
    xy = random.uniform(margin, 1 - margin, (count, 2)) * [max(cols - 1, 0), max(rows - 1, 0)]
    if random.random() < 0.3:
        xy = np.rint(xy)
    odd = random.random((count, 2)) < random.choice([0, 0.1])
    xy[odd] = random.choice(
        [np.nan, np.inf, -np.inf, -0.5, -0.501, 1e300, 2.0**31, -(2.0**63), cols - 0.5, 1e-310], odd.sum()
    )
    return unusual_array(random, xy) if random.random() < 0.03 else Argument(xy)


def seeds(random: Random, points: np.ndarray) -> Argument:
    """A map for each subset: about the identity, turned, mirrored, shrunk to a point, blown up, bent, or NaN."""
    maps = np.zeros((len(points), 2, 6))
    kind = random.integers(16)
    angle = np.deg2rad(random.choice([0.0, 1.0, 30.0, 90.0, 180.0])) if kind == 0 else 0.0
    scale = random.choice([0.0, 1e-30, 1e-3, 0.5, -1.0, 3.0, 1e37, -1e300]) if kind == 1 else 1.0
    linear = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    if kind == 2:
        linear[:, 0] *= -1
    with np.errstate(invalid="ignore"):
        maps[:, :, 0] = np.rint(points) + random.normal(0, random.choice([0, 0.3, 3]), points.shape)
    maps[:, :, 1:3] = linear
    if kind == 3:
        maps[:, :, 3:] = random.normal(0, 1, (len(points), 2, 3)) * 10.0 ** random.integers(-5, 40)
    if kind == 4:
        odd = random.random(maps.shape) < 0.02
        maps[odd] = random.choice([np.nan, np.inf, -np.inf, 1e308, -1e308, 1e-320], odd.sum())
    if kind == 5:
        maps[...] = random.choice([np.nan, np.inf, -np.inf, 0.0, 1.0, 1e37])
    if len(points) and random.random() < 0.05:
        return wrong(maps[1:]) if random.random() < 0.5 else unusual_array(random, maps)
    return Argument(maps)


def indices(random: Random, count: int) -> Argument:
    kind = random.integers(20)
    if kind < 10:
        return Argument(None)
    chosen = random.integers(0, max(count, 1), 0 if count == 0 else random.integers(0, 60)).astype(np.int32)
    if kind == 10:
        chosen = np.append(chosen, np.int32(random.choice([-1, count, 2**31 - 1, -(2**31)])))
        return wrong(chosen)
    if kind == 11 and len(chosen) > 1:
        while (unusual := unusual_array(random, chosen)).value is None:  # which would be all subsets
            pass
        return unusual
    return Argument(chosen)


THREADS = [0, 1, 1, 1, 2, 7]


# Calls


NAMED_AS = {"name": "instruction set"}


class Calls:
    """Makes calls and counts how they end."""

    def __init__(self) -> None:
        self.ends: Counter[str] = Counter()
        self.statuses: Counter[int] = Counter()

    def __call__(self, function, **arguments: Argument):
        """What the call returns; None if it raised, as it should have."""
        expected = [name for name, argument in arguments.items() if argument.is_wrong]
        name = getattr(function, "__name__", type(function).__name__)
        try:
            result = function(**{name: argument.value for name, argument in arguments.items()})
        except (TypeError, ValueError, IndexError) as error:
            assert expected, f"{name} refused what is right: {error}"
            # pybind11 names all arguments when one has a type that it cannot pass on.
            assert any(NAMED_AS.get(wrong_one, wrong_one) in str(error) for wrong_one in expected), str(error)
            self.ends[f"{name} raised"] += 1
            return None
        assert not expected, f"{name} took wrong {expected}"
        self.ends[f"{name} returned"] += 1
        return result


def check_results(found, reference, seeds, chosen, target_shape, max_iterations, min_zncc) -> None:
    x, y, sigma_x, sigma_y, zncc, iterations, status = found
    seeds = seeds if chosen is None else seeds[chosen]
    assert all(len(column) == len(seeds) for column in found)
    assert np.isin(status, list(SubsetStatus)).all()
    np.testing.assert_array_equal(status == SubsetStatus.SKIPPED, np.isnan(seeds).any(axis=(1, 2)))
    valid = status == SubsetStatus.CONVERGED
    for column in (x, y, sigma_x, sigma_y):
        np.testing.assert_array_equal(np.isnan(column), ~valid)
    assert (sigma_x[valid] > 0).all() and (sigma_y[valid] > 0).all()
    assert np.isfinite(sigma_x[valid]).all() and np.isfinite(sigma_y[valid]).all()
    # The last step, up to 0.02 px, is not sampled any more.
    rows, cols = target_shape
    assert (np.abs(x[valid] - (cols - 1) / 2) <= (cols - 1) / 2 + 0.5).all()
    assert (np.abs(y[valid] - (rows - 1) / 2) <= (rows - 1) / 2 + 0.5).all()
    assert (iterations <= max_iterations).all() and (iterations[valid] > 0).all()
    # A cosine, in float32.
    assert (np.isnan(zncc) | (np.abs(zncc) <= 1 + 1e-6)).all()
    assert (zncc[valid] >= np.float32(min_zncc)).all()
    assert np.isnan(zncc[iterations == 0]).all()


def one_round(random: Random, calls: Calls) -> None:
    """A reference and a target of random arguments, searched and sampled twice."""
    names = [*_kernel.instruction_sets(), *_kernel.instruction_sets(), "mmx", ""]
    for name in random.permutation(names).tolist():  # a right one at last
        calls(_kernel.use_instruction_set, name=Argument(name, name not in _kernel.instruction_sets()))
        if name in _kernel.instruction_sets():
            break

    rows, cols = length(random), length(random)
    grey = pattern(random, rows, cols)
    degree = whole_number(random, 3, 5, [3, 5])
    order = whole_number(random, 1, 2, [1, 2])
    size = whole_number(random, 5, 1001, [5, 5, 7, 9, 9, 11, 11, 15, 15, 15, 21, 21, 31, 31, 41, 301, 1001])
    if random.random() < 0.03:
        size = wrong(int(random.choice([-1, 0, 1, 3, 4, 30, 1002, 46342])))
    smoothing = real_number(random, 0, 5, [0, 0.7, 0.7, 1, 5, 1e-300])
    points = centres(random, rows, cols)
    reference = calls(
        _kernel.Reference,
        image=image(random, grey),
        centres=points,
        subset_size=size,
        degree=degree,
        order=order,
        smoothing=smoothing,
        threads=whole_number(random, 0, 1024, THREADS),
    )

    moved = np.roll(grey, random.integers(-2, 3, 2), axis=(0, 1))
    if random.random() < 0.2:
        moved = moved[: length(random), : length(random)]
    if random.random() < 0.2:
        moved = pattern(random, *moved.shape)
    if random.random() < 0.2 and moved.size:
        moved[:, moved.shape[1] // 2 :] = 200
    target = calls(_kernel.Target, image=image(random, moved), degree=degree)
    if target is None:
        return
    sampled(random, calls, target, moved.shape)
    if reference is None:
        return
    assert len(reference) == len(points.value)
    for _ in range(2):
        correlated(random, calls, reference, target, points.value, moved.shape)


def sampled(random: Random, calls: Calls, target, shape: tuple[int, int]) -> None:
    points = centres(random, *shape)
    values = calls(target.sample, points=points)
    if values is not None:
        with np.errstate(invalid="ignore"):
            inside = ((points.value >= 0) & (points.value <= np.array(shape[::-1]) - 1)).all(axis=1)
        assert np.isnan(values[~inside]).all()
        assert len(values) == len(points.value)


def correlated(random: Random, calls: Calls, reference, target, points: np.ndarray, shape: tuple[int, int]) -> None:
    arguments = {
        "seeds": seeds(random, points),
        "indices": indices(random, len(points)),
        "max_iterations": whole_number(random, 1, 255, [1, 2, 20, 20, 20, 255]),
        "tolerance_px": real_number(random, 1e-9, 1, [1e-6, 1e-4, 1e-4, 1e-3, 0.1]),
        "min_zncc": real_number(random, -1, 1, [-1, 0, 0.8, 0.8]),
        "min_contrast": real_number(random, 0, np.inf, [0, 2, 2]),
        "max_shift_px": real_number(random, 0, 1e6, [0.5, 10, 10, 300]),
        "max_misfit_px": real_number(random, 0, np.inf, [0.02, 0.02, 0.2, np.inf]),
        "threads": whole_number(random, 0, 1024, THREADS),
    }
    found = calls(_kernel.correlate, reference=Argument(reference), target=Argument(target), **arguments)
    if found is None:
        return
    calls.statuses.update(found[-1].tolist())
    values = {name: argument.value for name, argument in arguments.items()}
    check_results(
        found, reference, values["seeds"], values["indices"], shape, values["max_iterations"], values["min_zncc"]
    )
    if random.random() < 0.3:
        values["threads"] = int(random.choice(THREADS))
        again = calls(
            _kernel.correlate,
            reference=Argument(reference),
            target=Argument(target),
            **{name: Argument(value) for name, value in values.items()},
        )
        for one, two in zip(found, again, strict=True):
            assert one.tobytes() == two.tobytes(), "the number of threads changed the result"


def test_random_calls_end_in_consistent_results_or_in_an_error_that_names_the_argument():
    calls = Calls()
    seed = 0
    while calls.ends.total() < CALLS:
        seed += 1
        random = np.random.default_rng([SEED, seed])
        try:
            one_round(random, calls)
        except Exception as error:
            raise AssertionError(f"round of seed [{SEED}, {seed}]: {error}") from error
    assert set(calls.statuses) == set(SubsetStatus)
    # Enough of each, so that all of the above was put to the test.
    assert calls.statuses[SubsetStatus.CONVERGED] > CALLS / 50
    raised = sum(count for end, count in calls.ends.items() if end.endswith("raised"))
    assert 0.1 < raised / calls.ends.total() < 0.6
    assert all(calls.ends[f"{name} raised"] for name in ("Reference", "Target", "correlate", "sample"))


def test_python_threads_share_a_target_and_a_reference():
    """Each asks for another part, so that the part of the target that is ready grows while others use it."""
    random = np.random.default_rng(3)
    grey = np.clip(128 + 250 * ndimage.gaussian_filter(random.normal(0, 1, (300, 300)), 1.5), 0, 255).astype(np.uint8)
    points = np.stack(np.meshgrid(np.arange(20.0, 280, 8), np.arange(20.0, 280, 8)), axis=-1).reshape(-1, 2)
    maps = np.zeros((len(points), 2, 6))
    maps[:, :, 0] = points + 0.3
    maps[:, 0, 1] = maps[:, 1, 2] = 1
    reference = _kernel.Reference(grey, points, 15, 5)
    alone = np.array(_kernel.correlate(reference, _kernel.Target(grey, 5), maps, threads=1)[:2])
    parts = [part.astype(np.int32) for part in np.array_split(np.arange(len(points)), 40)]
    with ThreadPoolExecutor(4) as pool:
        for _ in range(5):
            target = _kernel.Target(grey, 5)
            random.shuffle(parts)
            searches = [pool.submit(_kernel.correlate, reference, target, maps, part, threads=2) for part in parts]
            samples = [pool.submit(target.sample, points) for _ in range(4)]
            for part, search in zip(parts, searches, strict=True):
                # The filter starts elsewhere, so coefficients are rounded otherwise, by 2e-5 grey levels: over 15 x 15
                # px with gradients of 20 grey levels/px, 1e-7 px at one standard deviation, several times that at most.
                np.testing.assert_allclose(search.result()[:2], alone[:, part], rtol=0, atol=1e-6)
            for values in samples:
                np.testing.assert_allclose(
                    values.result(), grey[points.astype(int)[:, 1], points.astype(int)[:, 0]], atol=1e-3
                )
