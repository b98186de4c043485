"""Fast DDS gets our profiles unless the user has some."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import pytest

from lsl_to_ros.fastdds import IN_FOLDER, VARIABLES, use_our_profiles


def test_without_profiles_of_the_user_ours_are_named_and_there(tmp_path: Path) -> None:
    environment: dict[str, str] = {}
    assert use_our_profiles(environment, tmp_path)
    (path,) = set(environment.values())
    assert set(environment) == set(VARIABLES)
    periods = ElementTree.parse(path).getroot().findall(".//{*}heartbeatPeriod")
    assert [period.findtext("{*}nanosec") for period in periods] == ["50000000"]


@pytest.mark.parametrize("name", VARIABLES)
def test_a_file_that_the_user_names_stays(tmp_path: Path, name: str) -> None:
    environment = {name: "mine.xml"}
    assert not use_our_profiles(environment, tmp_path)
    assert environment == {name: "mine.xml"}


@pytest.mark.parametrize("name", IN_FOLDER)
def test_a_file_in_the_working_folder_stays(tmp_path: Path, name: str) -> None:
    (tmp_path / name).touch()
    environment: dict[str, str] = {}
    assert not use_our_profiles(environment, tmp_path)
    assert environment == {}
