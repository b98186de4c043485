from setuptools import find_packages, setup

PACKAGE = "lsl_to_ros"
LAUNCH_FILES = [
    f"launch/{node}.launch.{form}"
    for node in ("lsl_to_ros", "ros_to_lsl")
    for form in ("py", "xml", "yaml")
]

setup(
    name=PACKAGE,
    version="0.1.0",
    packages=find_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    package_data={PACKAGE: ["py.typed", "fastdds*.xml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (f"share/{PACKAGE}/launch", LAUNCH_FILES),
        (
            f"share/{PACKAGE}/config",
            ["config/lsl_to_ros.policy.xml", "config/params.yaml", "config/ros_to_lsl.yaml"],
        ),
    ],
    # ROS packages are named in package.xml; this one comes from PyPI.
    install_requires=["pylsl>=1.18"],
    # By this colcon test knows who runs the tests.
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="Biosensor Gateway maintainers",
    maintainer_email="maintainers@biosensor-gateway.org",
    description="Publishes every LSL stream as ROS 2 topics, and sends topics as streams",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "lsl_to_ros = lsl_to_ros.node:main",
            "ros_to_lsl = lsl_to_ros.ros_to_lsl.node:main",
        ],
        # Read by ``ros2 doctor`` where ros2doctor is installed; nothing needs it.
        "ros2doctor.checks": ["BiosensorCheck = lsl_to_ros.doctor.ros2_doctor:BiosensorCheck"],
        "ros2doctor.report": ["BiosensorReport = lsl_to_ros.doctor.ros2_doctor:BiosensorReport"],
    },
)
