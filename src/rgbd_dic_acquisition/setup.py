from glob import glob

from setuptools import find_packages, setup

package_name = "rgbd_dic_acquisition"
share = f"share/{package_name}"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (share, ["package.xml"]),
        (f"{share}/config", glob("config/*")),
        (f"{share}/launch", glob("launch/*.launch.py")),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    maintainer="rgbd_dic maintainers",
    maintainer_email="maintainers@rgbd-dic.invalid",
    description="Sensors, recordings and the flight simulator of rgbd_dic.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            f"{node} = {package_name}.nodes.{node}:main"
            for node in ("camera_node", "tof_node", "mavlink_node", "recorder_node", "player_node")
        ],
    },
)
