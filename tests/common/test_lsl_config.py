"""How LSL is configured: whose file is read, which library, which predicates find streams."""

from __future__ import annotations

import ast
import configparser
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pylsl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_common import liblsl
from biosensor_common.errors import ConfigError, ConfigReason, SpecError
from biosensor_common.lsl.api_file import (
    LslApiFile,
    LslOverrides,
    config_places,
    effective_config,
    home_config_file,
    ports,
    user_config_file,
    value,
)
from biosensor_common.lsl.inlet import MOST_BUFFERED, buffer_length
from biosensor_common.lsl.network import matches_query
from biosensor_common.lsl.predicates import (
    EVERYTHING,
    NOTHING,
    Predicate,
    all_of,
    any_of,
    ends_with,
    equals,
    has,
    none_of,
    of_user,
)
from biosensor_gateway.features.outputs import feature_streams
from lsl_to_ros.lsl.inlets import FROM_ROS

# The configuration of LSL: whose file is read, and what is laid over it.


def overlaid(text: str, overrides: LslOverrides, folder: Path) -> dict[str, dict[str, str]]:
    """Lay the overrides over a user's file; return the settings by section."""
    path = folder / "lsl_api.cfg"
    path.write_text(text)
    parser = configparser.RawConfigParser()
    parser.optionxform = str  # type: ignore[assignment,method-assign]
    parser.read_string(effective_config(path, overrides))
    return {section: dict(parser[section]) for section in parser.sections()}


def test_lsl_s_own_order_is_kept(tmp_path: Path) -> None:
    home, folder, named = tmp_path / "home", tmp_path / "folder", tmp_path / "named.cfg"
    environment = {"LSLAPICFG": str(named)}
    places = config_places(environment, home, folder)
    assert places[:3] == (named, folder / "lsl_api.cfg", home / "lsl_api" / "lsl_api.cfg")
    assert places[1:] == config_places({"LSLAPICFG": ""}, home, folder)
    for place in reversed(places[:3]):
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text("")
        assert user_config_file(environment, home, folder) == place
    assert user_config_file({}, home, folder) == folder / "lsl_api.cfg"
    assert home_config_file(home) in places


def test_the_user_s_settings_stay_where_ours_are_silent(tmp_path: Path) -> None:
    own = "[lab]\nSessionID = mine\nKnownPeers = {10.0.0.1}\n[tuning]\nMaxCachedQueries = 7\n"
    assert overlaid(own, LslOverrides(), tmp_path) == {
        "lab": {"SessionID": "mine", "KnownPeers": "{10.0.0.1}"},
        "tuning": {"MaxCachedQueries": "7"},
        "ports": {"PortRange": "256"},
        "log": {"level": "-1"},
    }


def test_ours_go_before_the_user_s(tmp_path: Path) -> None:
    own = "[lab]\nSessionID = mine\nKnownPeers = {10.0.0.1}\n[ports]\nPortRange = 512\n"
    overrides = LslOverrides("ours", ("10.0.0.2", "10.0.0.3"), 64)
    found = overlaid(own, overrides, tmp_path)
    assert found["lab"] == {"SessionID": "ours", "KnownPeers": "{10.0.0.2, 10.0.0.3}"}
    assert found["ports"] == {"PortRange": "64"}


def test_how_long_a_search_pauses_is_left_to_the_user(tmp_path: Path) -> None:
    own = "[tuning]\nUnicastMinRTT = 2\n"
    found = overlaid(own, LslOverrides(search_pause_s=0.1), tmp_path)
    assert found["tuning"] == {"UnicastMinRTT": "2", "MulticastMinRTT": "0.1"}
    assert "tuning" not in overlaid("", LslOverrides(), tmp_path)


@pytest.mark.parametrize(
    ("own", "effective"), [("512", "512"), ("32", "256"), ("many", "256"), ("-1", "256")]
)
def test_without_a_setting_of_ours_a_larger_range_of_ports_stays(
    own: str, effective: str, tmp_path: Path
) -> None:
    found = overlaid(f"[ports]\nPortRange = {own}\n", LslOverrides(), tmp_path)
    assert found["ports"] == {"PortRange": effective}


def test_a_damaged_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "lsl_api.cfg"
    path.write_text("SessionID\n")
    with pytest.raises(ConfigError, match=str(path)) as raised:
        effective_config(path, LslOverrides())
    assert raised.value.reason is ConfigReason.MALFORMED
    path.write_bytes(b"[lab]\nSessionID = \xff\n")
    with pytest.raises(ConfigError, match=str(path)) as raised:
        effective_config(path, LslOverrides())
    assert raised.value.reason is ConfigReason.UNREADABLE


@pytest.mark.parametrize("session", ["Lab's 1", "x' or '1'='1", "'"])
def test_a_session_that_no_query_can_name_is_refused(session: str, tmp_path: Path) -> None:
    # Of the first liblsl finds no stream, of the second those of all sessions.
    path = tmp_path / "lsl_api.cfg"
    path.write_text(f"[lab]\nSessionID = {session}\n")
    with pytest.raises(ConfigError, match=str(path)) as raised:
        effective_config(path, LslOverrides())
    assert raised.value.reason is ConfigReason.WRONG_VALUE
    with pytest.raises(ConfigError, match="session_id") as raised:
        effective_config(None, LslOverrides(session))
    assert raised.value.reason is ConfigReason.WRONG_VALUE
    assert overlaid(path.read_text(), LslOverrides("ours"), tmp_path)["lab"]["SessionID"] == "ours"


@pytest.mark.parametrize(
    "line",
    [
        *("[ports]\nBasePort = abc", "[ports]\nMulticastPort = 99999", "[ports]\nIPv6 = maybe"),
        *("[multicast]\nResolveScope = campus", "[multicast]\nTTLOverride = x"),
        *("[multicast]\nSiteAddresses = {300.1.1.1}", "[multicast]\nLinkAddresses = 224.0.0.1"),
        *("[tuning]\nMulticastMinRTT = 0,5", "[log]\nlevel = 10", "[lab]\n[ports = 3"),
    ],
)
def test_what_would_have_lsl_take_other_settings_is_refused(line: str, tmp_path: Path) -> None:
    path = tmp_path / "lsl_api.cfg"
    path.write_text(f"{line}\n")
    with pytest.raises(ConfigError, match=re.escape(str(path))) as raised:
        effective_config(path, LslOverrides(session_id="lab7"))
    assert raised.value.reason is ConfigReason.WRONG_VALUE
    assert re.escape(line.rpartition("\n")[2].partition(" =")[0]) in re.escape(str(raised.value))


def test_every_usual_value_is_taken(tmp_path: Path) -> None:
    own = {
        "ports": {"BasePort": "17000", "IPv6": "disable", "AllowRandomPorts": "false"},
        "multicast": {"ResolveScope": "link", "AddressesOverride": "{}", "TTLOverride": "-1"},
        "tuning": {"MulticastMinRTT": "0.25", "ForceDefaultTimestamps": "0"},
    }
    lines = [
        line
        for section, values in own.items()
        for line in (f"[{section}]", *(f"{key} = {value}" for key, value in values.items()))
    ]
    found = overlaid("\n".join(lines), LslOverrides(), tmp_path)
    assert {section: found[section] | values for section, values in own.items()} == {
        section: found[section] for section in own
    }


def test_an_empty_value_an_indented_line_and_peers_without_braces_cost_no_setting(
    tmp_path: Path,
) -> None:
    own = "[ports]\nIPv6 =\n[lab]\nSessionID = theirs\n  KnownPeers = 10.0.0.1, 10.0.0.2\n"
    found = overlaid(own, LslOverrides(session_id="lab7"), tmp_path)
    assert found["lab"] == {"SessionID": "lab7", "KnownPeers": "{10.0.0.1, 10.0.0.2}"}


def test_a_comment_behind_a_number_or_peers_is_none_of_them(tmp_path: Path) -> None:
    own = "[ports]\nBasePort = 16700 ; ours\n[lab]\nKnownPeers = {10.0.0.1} ; the robot\n"
    path = tmp_path / "lsl_api.cfg"
    path.write_text(own)
    config = effective_config(path, LslOverrides())
    assert ports(config).first == LslApiFile(own, str(path)).ports.first == 16700
    assert value(config, "lab", "KnownPeers") == "{10.0.0.1}"
    assert LslApiFile(own, str(path)).known_peers == ("10.0.0.1",)


def test_a_place_that_may_not_be_looked_into_has_no_file(tmp_path: Path) -> None:
    own = tmp_path / "lsl_api.cfg"
    own.touch()
    # Not even root can ask for a name that long.
    hidden = {"LSLAPICFG": str(tmp_path / ("x" * 300))}
    assert user_config_file(hidden, tmp_path / ("x" * 300), tmp_path) == own


@pytest.mark.parametrize("rate", [0.0, 0.5, 1.0, 256.0, MOST_BUFFERED / 121])
def test_a_usual_stream_is_buffered_for_so_long(rate: float) -> None:
    assert buffer_length(rate, 120) == 120


@pytest.mark.parametrize("rate", [MOST_BUFFERED / 119, 1e5, 1e6, 1e9])
def test_no_rate_takes_more_memory_than_the_bound_or_a_second(rate: float) -> None:
    length = buffer_length(rate, 120)
    assert 1 <= length < 120
    assert length * rate <= max(MOST_BUFFERED, rate)
    assert buffer_length(rate, 10, 200_000) <= length


# Which library pylsl is given where it brings none, and what is said where there is none.
BROUGHT = {
    "pylsl": "lib/liblsl.so",
    "biosensor_liblsl": "liblsl.so",
    "mne_lsl": "lsl/lib/liblsl.so.1.17.7",
}


@pytest.fixture
def packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of packages in place of those that are installed, on Linux."""

    def find_spec(name: str) -> SimpleNamespace | None:
        folder = tmp_path / name
        return (
            SimpleNamespace(submodule_search_locations=[str(folder)]) if folder.is_dir() else None
        )

    monkeypatch.setattr(liblsl, "find_spec", find_spec)
    monkeypatch.setattr(sys, "platform", "linux")
    (tmp_path / "pylsl" / "lib").mkdir(parents=True)
    return tmp_path


def _bring(packages: Path, name: str) -> str:
    library = packages / name / BROUGHT[name]
    library.parent.mkdir(parents=True, exist_ok=True)
    library.touch()
    return str(library)


@pytest.mark.parametrize(
    ("there", "taken"),
    [
        ((), ""),
        (("mne_lsl",), "mne_lsl"),
        (("mne_lsl", "biosensor_liblsl"), "biosensor_liblsl"),
        (("pylsl", "biosensor_liblsl"), ""),
    ],
)
def test_another_library_is_taken_only_where_pylsl_brings_none(
    packages: Path, there: tuple[str, ...], taken: str
) -> None:
    places = {name: _bring(packages, name) for name in there}
    environment: dict[str, str] = {}
    liblsl.provide(environment)
    assert environment == ({liblsl.VARIABLE: places[taken]} if taken else {})


def test_what_a_person_has_named_stays(packages: Path) -> None:
    _bring(packages, "biosensor_liblsl")
    environment = {liblsl.VARIABLE: "/opt/liblsl.so"}
    liblsl.provide(environment)
    assert environment == {liblsl.VARIABLE: "/opt/liblsl.so"}


def test_nothing_is_named_on_other_systems(packages: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _bring(packages, "biosensor_liblsl")
    monkeypatch.setattr(sys, "platform", "darwin")
    environment: dict[str, str] = {}
    liblsl.provide(environment)
    assert environment == {}


@pytest.mark.parametrize(
    ("machine", "libc", "said"),
    [
        ("x86_64", ("glibc", "2.36"), "--force-reinstall pylsl"),
        ("x86_64", ("glibc", "2.31"), "--no-deps mne-lsl"),
        ("aarch64", ("glibc", "2.36"), "--no-deps mne-lsl"),
        ("aarch64", ("", ""), "set PYLSL_LIB"),
        ("armv7l", ("glibc", "2.36"), "set PYLSL_LIB"),
    ],
)
def test_the_remedy_is_one_for_this_computer(
    monkeypatch: pytest.MonkeyPatch, machine: str, libc: tuple[str, str], said: str
) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr("platform.machine", lambda: machine)
    monkeypatch.setattr("platform.libc_ver", lambda: libc)
    assert said in liblsl.remedy()


def test_other_errors_are_not_taken_for_it() -> None:
    with pytest.raises(RuntimeError, match="LSL binary") as raised:
        raise RuntimeError("LSL binary library file was not found")
    assert liblsl.what_is_missing(raised.value) == ""


def test_a_program_that_lacks_it_ends_with_one_sentence(
    capsys: pytest.CaptureFixture[str],
) -> None:
    # As pylsl does when it is imported.
    code = compile("raise RuntimeError('not found. Please\\nread on')", "lib", "exec")
    with pytest.raises(SystemExit) as ended, liblsl.needed_by("lsl_to_ros"):
        exec(code, {"__name__": "pylsl.lib"})
    assert ended.value.code == 1
    said = capsys.readouterr().err
    assert said.startswith("lsl_to_ros: liblsl, the library of the Lab Streaming Layer, cannot be")
    assert said.count("\n") == 1
    with pytest.raises(RuntimeError), liblsl.needed_by("lsl_to_ros"):
        raise RuntimeError("another one")


# Predicates of resolvers: liblsl puts the session before them, and no value escapes.
ROOT = Path(__file__).parents[2]
PRODUCT = ("common", "gateway_win", "ros_side")
BUILDER = "predicates.py"
# What XPath looks like.
XPATH = re.compile(
    r"\b(name|type|source_id|session_id|uid|hostname|channel_count)\s*=\s*['\"]"
    r"|\b(starts-with|string-length|substring)\(|\btrue\(\)|\bcontains\(\w+,|^desc/\w+ "
)
# Sentences for a person, pages, and what another program is told.
NO_PREDICATES = ("LSL query", "in pylsl", "netsh ", "<!DOCTYPE html>")
RESOLVING = {"ContinuousResolver", "resolve_bypred"}
WITHOUT_BRACKETS = {"resolve_byprop", "resolve_stream"}
# Only a text that has one of these is worth parsing.
WORTH_PARSING = re.compile(
    r"esolve|Predicate|IN_ANY_SESSION|\b(name|type|\w+_id|uid|hostname|channel_count)\s*=\s*\\?['\"]"
    r"|starts-with|string-length|substring|true\(\)|contains\(|desc/"
)
ECG = pylsl.StreamInfo('it\'s "P01"', "ECG", 1, 130.0, "float32", "p01-ecg")
BUILT = [
    EVERYTHING,
    any_of(equals("type", "PPG"), equals("type", "ECG")),
    any_of(equals("type", "ECG"), equals("type", "PPG"), EVERYTHING),
    all_of(any_of(equals("name", ECG.name()), NOTHING), equals("type", "ECG")),
    any_of(NOTHING, ends_with("source_id", "-ecg")),
    none_of(equals("type", "PPG"), has("desc/ros")),
    none_of(FROM_ROS),
    of_user("type='PPG' or type='ECG'"),
]


@pytest.mark.parametrize("predicate", BUILT)
def test_a_stream_of_another_session_is_never_found(predicate: Predicate) -> None:
    assert matches_query(ECG, predicate)
    # So liblsl writes it.
    assert not matches_query(ECG, f"session_id='another one' and {predicate}")


def test_the_features_of_another_session_are_never_found() -> None:
    info = pylsl.StreamInfo("any", "HR", 1, 0.0, "float32", "p01-hr_live")
    assert matches_query(info, feature_streams())
    assert not matches_query(info, f"session_id='another one' and {feature_streams()}")


@pytest.mark.parametrize(
    ("predicate", "fits"),
    [
        (equals("type", "PPG"), False),
        (ends_with("source_id", "ecg"), True),
        (ends_with("source_id", "p01-ecg and more"), False),
        (ends_with("source_id", "-hr"), False),
        (all_of(), True),
        (any_of(), False),
        (none_of(), True),
        (all_of(equals("type", "ECG"), equals("name", "other")), False),
        (none_of(equals("type", "ECG")), False),
        (equals("name", "it's"), False),
        (equals("source_id", "p01-ecg\0"), False),
        (ends_with("source_id", "ecg\0"), False),
    ],
)
def test_a_predicate_finds_what_it_says(predicate: Predicate, fits: bool) -> None:
    assert matches_query(ECG, predicate) is fits


# liblsl writes a header and reads it again, and XML makes one space of others.
TEXT = st.text(st.sampled_from("ab'\"()[]=/ or,äµ"), min_size=1).map(str.strip).filter(bool)


@given(name=TEXT, other=TEXT)
def test_each_value_is_found_and_no_other(name: str, other: str) -> None:
    info = pylsl.StreamInfo(name, "Test", 1, 0.0, "float32", "any")
    assert matches_query(info, equals("name", name))
    assert matches_query(info, ends_with("name", name))
    assert matches_query(info, equals("name", other)) is (name == other)


@given(text=st.text(st.sampled_from("a=1'\"()[]|/ ")))
def test_what_a_person_wrote_stays_in_its_brackets(text: str) -> None:
    try:
        predicate = of_user(text)
    except SpecError:
        return
    assert not matches_query(ECG, f"session_id='another one' and {predicate}")


@pytest.mark.parametrize(
    "text", ["'", '"', "(", ")", "true()) or (true()", "(]", "name='a)", "true()] | /info[true()"]
)
def test_what_is_open_is_refused(text: str) -> None:
    with pytest.raises(SpecError, match="unmatched"):
        of_user(text)


def _modules() -> Iterator[tuple[Path, ast.Module]]:
    for folder in PRODUCT:
        for path in sorted((ROOT / folder).rglob("*.py")):
            if "build" not in path.parts and path.name != BUILDER:
                text = path.read_text("utf-8")
                if WORTH_PARSING.search(text):
                    yield path, ast.parse(text)


def _xpath_in(module: ast.AST) -> Iterator[str]:
    docstrings = {
        id(node.body[0].value)
        for node in ast.walk(module)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)
        and node.body
        and isinstance(node.body[0], ast.Expr)
    }
    for node in ast.walk(module):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            is_said = id(node) in docstrings or any(each in node.value for each in NO_PREDICATES)
            if not is_said and XPATH.search(node.value):
                yield f"{node.lineno}: {node.value}"


def _wrong_calls_in(module: ast.AST) -> Iterator[str]:
    for node in ast.walk(module):
        if not isinstance(node, ast.Call):
            continue
        called = node.func.attr if isinstance(node.func, ast.Attribute) else ""
        asked = [*node.args, *(each.value for each in node.keywords if each.arg == "pred")]
        is_text = any(isinstance(each, ast.Constant | ast.JoinedStr) for each in asked[:1])
        if called in WITHOUT_BRACKETS or (called in RESOLVING and is_text):
            yield f"{node.lineno}: {ast.unparse(node)}"


def _makes_predicates(module: ast.AST) -> bool:
    return any(
        isinstance(node, ast.Call) and getattr(node.func, "id", "") == "Predicate"
        for node in ast.walk(module)
    )


def test_doctor_alone_looks_into_other_sessions() -> None:
    using = [path.name for path, _ in _modules() if "IN_ANY_SESSION" in path.read_text("utf-8")]
    assert using == ["lsl_process.py"]


def test_only_the_builder_makes_predicates() -> None:
    found = {
        str(path.relative_to(ROOT)): lines
        for path, module in _modules()
        if (lines := [*_xpath_in(module), *_wrong_calls_in(module)]) or _makes_predicates(module)
    }
    assert found == {}


@pytest.mark.parametrize(
    "line",
    [
        "f\"type='{x}'\"",
        "\"starts-with(name, 'p01-')\"",
        "'desc/ros and not(desc/replay)'",
        "'true()'",
        'pylsl.resolve_byprop("source_id", x)',
        'pylsl.ContinuousResolver(pred="kind")',
        "pylsl.resolve_bypred(f'{x}')",
    ],
)
def test_a_predicate_elsewhere_would_be_found(line: str) -> None:
    assert WORTH_PARSING.search(line)
    module = ast.parse(f"x = {line}")
    assert [*_xpath_in(module), *_wrong_calls_in(module)]
