from setuptools import find_packages, setup

PACKAGE = "biosensor_common"

setup(
    name=PACKAGE,
    version="0.1.0",
    packages=find_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    package_data={PACKAGE: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ],
    # By this colcon test knows who runs the tests.
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="Biosensor Gateway maintainers",
    maintainer_email="maintainers@biosensor-gateway.org",
    description="What each biosensor emits, said once: streams, units, names and clocks",
    license="Apache-2.0",
)
