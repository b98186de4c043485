"""Settings and secrets: the file, the environment over it, where secrets come from."""

from __future__ import annotations

import os
import pickle
import re
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Literal

import keyring
import pytest
from keyring.backend import KeyringBackend
from keyring.backends import fail
from keyring.errors import KeyringLocked, PasswordDeleteError, PasswordSetError
from pydantic import BaseModel, Field, ValidationError

from biosensor_common.errors import (
    ConfigError,
    ConfigReason,
    CredentialError,
    CredentialReason,
    SpecError,
)
from biosensor_common.lsl.api_file import LslOverrides
from biosensor_gateway.settings.editor import template, write_template
from biosensor_gateway.settings.file import load_or_defaults, load_settings
from biosensor_gateway.settings.models import (
    DeviceSettings,
    EventSettings,
    GatewaySettings,
    LslSettings,
    MarkerSettings,
    PowerSettings,
    WebMarkerSettings,
)
from biosensor_gateway.settings.places import settings_path, state_folder
from biosensor_gateway.settings.secrets import (
    SERVICE,
    Secret,
    SecretName,
    find_secret,
    forget_secret,
    set_secret,
)

# Secrets: where they come from, and that they show nowhere.

NAME = SecretName("some_sensor", "client_id", "SOME_CLIENT_ID", "the client id")
OTHER = SecretName("some_sensor", "client_secret", "SOME_CLIENT_SECRET", "the client secret")
PLANTED = "planted-5f1c"


class MemoryKeyring(KeyringBackend):
    """A keyring that keeps everything to itself; `error` is raised instead, if there is one."""

    # Never chosen by itself: other tests have the user's own, or none.
    priority = 0  # pyright: ignore[reportAssignmentType] - a classproperty of the library

    def __init__(self) -> None:
        super().__init__()
        self.entries: dict[tuple[str, str], str] = {}
        self.error: Exception | None = None

    def get_password(self, service: str, username: str) -> str | None:
        self._fail()
        return self.entries.get((service, username))

    def set_password(self, service: str, username: str, password: str) -> None:
        self._fail()
        self.entries[service, username] = password

    def delete_password(self, service: str, username: str) -> None:
        self._fail()
        del self.entries[service, username]

    def _fail(self) -> None:
        if self.error is not None:
            raise self.error


@pytest.fixture
def store(monkeypatch: pytest.MonkeyPatch) -> Generator[MemoryKeyring]:
    for name in (NAME, OTHER):
        monkeypatch.delenv(name.variable, raising=False)
    before = keyring.get_keyring()
    memory = MemoryKeyring()
    keyring.set_keyring(memory)
    yield memory
    keyring.set_keyring(before)


def test_a_secret_is_stored_found_and_forgotten(store: MemoryKeyring) -> None:
    set_secret(NAME, f" {PLANTED}\n")
    assert store.entries == {(SERVICE, "some_sensor.client_id"): PLANTED}
    assert find_secret(NAME).reveal() == PLANTED
    assert forget_secret(NAME)
    assert not forget_secret(NAME)
    assert store.entries == {}


def test_the_environment_goes_before_the_keyring(
    store: MemoryKeyring, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_secret(NAME, "stored")
    monkeypatch.setenv(NAME.variable, f"{PLANTED}\n")
    assert find_secret(NAME).reveal() == PLANTED
    monkeypatch.setenv(NAME.variable, " ")
    assert find_secret(NAME).reveal() == "stored"
    assert store.error is None


def test_one_may_come_from_here_and_one_from_there(
    store: MemoryKeyring, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(NAME.variable, "from the environment")
    set_secret(OTHER, "from the keyring")
    assert find_secret(NAME).reveal() == "from the environment"
    assert find_secret(OTHER).reveal() == "from the keyring"
    assert len(store.entries) == 1


def test_a_secret_that_is_nowhere_is_missed_by_name(store: MemoryKeyring) -> None:
    with pytest.raises(CredentialError, match=r"the client id.*SOME_CLIENT_ID") as raised:
        find_secret(NAME)
    assert raised.value.reason is CredentialReason.MISSING
    assert store.entries == {}


def test_the_environment_needs_no_keyring(
    store: MemoryKeyring, monkeypatch: pytest.MonkeyPatch
) -> None:
    store.error = RuntimeError("must not be asked")
    monkeypatch.setenv(NAME.variable, PLANTED)
    assert find_secret(NAME).reveal() == PLANTED


@pytest.mark.usefixtures("store")
def test_a_computer_without_a_keyring_is_told_in_one_sentence() -> None:
    keyring.set_keyring(fail.Keyring())
    asked: tuple[Callable[[], object], ...] = (
        lambda: find_secret(NAME),
        lambda: forget_secret(NAME),
        lambda: set_secret(NAME, PLANTED),
    )
    for ask in asked:
        with pytest.raises(CredentialError) as raised:
            ask()
        assert raised.value.reason is CredentialReason.MISSING
        assert "no keyring; set SOME_CLIENT_ID or install a keyring" in str(raised.value)
        assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    "error",
    [KeyringLocked("x"), PasswordSetError(PLANTED), OSError(PLANTED), RuntimeError(PLANTED)],
)
def test_no_failure_of_a_keyring_quotes_a_secret(store: MemoryKeyring, error: Exception) -> None:
    store.error = error
    with pytest.raises(CredentialError) as raised:
        set_secret(NAME, PLANTED)
    assert NAME.variable in str(raised.value)
    assert PLANTED not in str(raised.value)
    assert raised.value.__cause__ is None
    assert raised.value.__context__ is None


def test_a_secret_that_somebody_else_has_just_forgotten_is_forgotten(
    store: MemoryKeyring, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_secret(NAME, PLANTED)

    def too_late(service: str, username: str) -> None:
        raise PasswordDeleteError(service, username)

    monkeypatch.setattr(store, "delete_password", too_late)
    assert not forget_secret(NAME)


@pytest.mark.parametrize("text", ["", " ", "\n"])
def test_nothing_is_no_secret(store: MemoryKeyring, text: str) -> None:
    with pytest.raises(CredentialError) as raised:
        set_secret(NAME, text)
    assert raised.value.reason is CredentialReason.REJECTED
    assert store.entries == {}


def test_a_secret_shows_itself_only_when_asked() -> None:
    secret = Secret(PLANTED)
    shown = (
        str(secret),
        repr(secret),
        f"{secret}",
        f"{secret!r:>20}",
        str([secret]),
    )
    assert not any(PLANTED in text for text in shown)
    assert secret.reveal() == PLANTED
    with pytest.raises(TypeError):
        pickle.dumps(secret)
    assert not hasattr(secret, "__dict__")


# Settings: the file, the environment over it, and what is said about mistakes.
class StrapSettings(DeviceSettings):
    """A device without settings of its own."""


class BoxSettings(DeviceSettings):
    """A device with settings of every sort."""

    port: str = Field(description="Serial port.", examples=["COM3"])
    gain: Literal["low", "high"] = Field(default="low", description="Amplifier.")
    channels: tuple[int, ...] = Field(default=(1, 2), strict=False, description="Which ones.")
    rate: float | None = Field(default=None, description="Sampling rate in Hz.")


MODELS: dict[str, type[DeviceSettings]] = {"strap": StrapSettings, "box": BoxSettings}


@pytest.fixture(autouse=True)
def clean_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in list(os.environ):
        if name.upper().startswith("BIOSENSOR_GATEWAY_"):
            monkeypatch.delenv(name)


Loader = Callable[[str], GatewaySettings]
Refusal = Callable[[str], ConfigError]


@pytest.fixture
def load(tmp_path: Path) -> Loader:
    def load_text(text: str) -> GatewaySettings:
        path = tmp_path / "settings.toml"
        path.write_bytes(text.encode())
        return load_settings(path, MODELS)

    return load_text


@pytest.fixture
def refuse(load: Loader) -> Refusal:
    def error_of(text: str) -> ConfigError:
        with pytest.raises(ConfigError) as caught:
            load(text)
        return caught.value

    return error_of


def test_an_empty_file_gives_the_defaults(load: Loader) -> None:
    settings = load("")
    assert settings == GatewaySettings()
    assert (settings.lsl.session_id, settings.lsl.port_range) == ("", 256)
    assert (settings.log.level, settings.devices) == ("info", ())
    assert settings.power.keep_awake


def test_everything_that_can_be_set_arrives(load: Loader) -> None:
    settings = load(
        """
        [lsl]
        session_id = "lab-2"
        known_peers = ["192.168.0.7", "robot.local", "fe80::1%eth0"]
        port_range = 128
        [log]
        level = "debug"
        [[device]]
        sensor = "strap"
        unit = "C0:FF:EE"
        participant = "p01"
        [[device]]
        sensor = "box"
        unit = "7"
        port = "COM3"
        channels = [3]
        rate = 50
        enabled = false
        """
    )
    assert settings.lsl.known_peers == ("192.168.0.7", "robot.local", "fe80::1%eth0")
    assert settings.log.level == "debug"
    assert settings.devices == (
        StrapSettings(sensor="strap", unit="C0:FF:EE", participant="p01"),
        BoxSettings(sensor="box", unit="7", port="COM3", channels=(3,), rate=50.0, enabled=False),
    )
    assert isinstance(settings.devices[1], BoxSettings)


@pytest.mark.parametrize(("text", "port_range"), [("", None), ("[lsl]\nport_range = 256", 256)])
def test_a_range_of_ports_goes_before_the_user_s_own_only_where_it_is_written(
    load: Loader, text: str, port_range: int | None
) -> None:
    lsl = load(text).lsl
    assert lsl.overrides == LslOverrides(port_range=port_range)
    # So it reaches another process, too.
    line = lsl.model_dump_json(exclude_unset=True)
    assert LslSettings.model_validate_json(line).overrides == lsl.overrides


def test_settings_do_not_change_once_loaded(load: Loader) -> None:
    with pytest.raises(ValidationError):
        load("").lsl.session_id = "other"


def test_a_byte_order_mark_is_no_mistake(load: Loader) -> None:
    assert load('\ufeff[log]\r\nlevel = "error"\r\n').log.level == "error"


def test_a_missing_file_says_how_to_make_one(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="biosensor-gateway config init") as caught:
        load_settings(tmp_path / "none.toml", MODELS)
    assert caught.value.reason is ConfigReason.NOT_FOUND


@pytest.mark.parametrize(
    ("content", "said"), [(None, "it is a folder"), ("x = 'ä'".encode("utf-16"), "not UTF-8")]
)
def test_what_is_no_text_file_is_unreadable(
    tmp_path: Path, content: bytes | None, said: str
) -> None:
    path = tmp_path / "settings.toml"
    path.mkdir() if content is None else path.write_bytes(content)
    with pytest.raises(ConfigError, match=said) as caught:
        load_settings(path, MODELS)
    assert caught.value.reason is ConfigReason.UNREADABLE


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("[lsl]\nport_range 3", "line 2, column 12: not valid TOML: expected '='"),
        ("[lsl]\n[lsl]\n", "line 2, column 5"),
        ("a = " + "[" * 5000, "nested too deeply"),
        ("a = " + "1" * 5000, "not valid TOML: "),
    ],
)
def test_malformed_toml_says_where(refuse: Refusal, text: str, where: str) -> None:
    error = refuse(text)
    assert error.reason is ConfigReason.MALFORMED
    assert where in str(error)


DEVICE = '[[device]]\nsensor = "strap"\nunit = "A"\n'


@pytest.mark.parametrize(
    ("text", "line", "said"),
    [
        ("\n[lsl]\nsesion_id = 'x'", 3, "'lsl.sesion_id' (did you mean 'session_id'?); known keys"),
        (
            "\n[lls]\nkey = 1",
            2,
            "'lls' (did you mean 'lsl'?); known keys: lsl, log, power, events, markers, device",
        ),
        ("[LSL]\nport_range = 1", 1, "'LSL' (did you mean 'lsl'?"),
        ("devices = []", 1, "'devices' (did you mean 'device'?"),
        ("_cli_parse_args = true", 1, "'_cli_parse_args'"),
        (DEVICE + "particpant = 'p'", 4, "'device.particpant' (did you mean 'participant'?"),
    ],
)
def test_an_unknown_key_is_named_with_its_line(
    refuse: Refusal, text: str, line: int, said: str
) -> None:
    error = refuse(text)
    assert error.reason is ConfigReason.UNKNOWN_KEY
    assert f"settings.toml, line {line}: unknown key {said}" in str(error)


@pytest.mark.parametrize(
    ("text", "line", "said"),
    [
        ("[lsl]\nport_range = '256'", 2, "'lsl.port_range' should be an integer, but is '256'"),
        ("[lsl]\nport_range = true", 2, "should be an integer, but is true"),
        ("[lsl]\nport_range = 0", 2, "should be greater than or equal to 1, but is 0"),
        ("[lsl]\nport_range = 32769", 2, "should be less than or equal to 32768"),
        ("[lsl]\nsession_id = 3", 2, "should be text in quotes"),
        ('[lsl]\nsession_id = "a\\nb"', 2, "should have only letters, digits"),
        ("[lsl]\nknown_peers = 'pc'", 2, "should be a list in square brackets"),
        ("[lsl]\nknown_peers = [\n'pc',\n'{x}']", 4, "should be a host name or an IP address"),
        ("lsl = 3", 1, "'lsl' should be a table"),
        ("[log]\nlevel = 'loud'", 2, "should be 'debug', 'info', 'warning' or 'error', but is"),
        ("[log]\nkeep_files = 0", 2, "'log.keep_files'"),
        ("[power]\nkeep_awake = 'no'", 2, "'power.keep_awake' should be true or false, but is"),
        (DEVICE + f"label = '{'x' * 33}'", 4, "'device.label' should have at most 32 characters"),
        (DEVICE + "label = ' left'", 4, "should be printable text without spaces at its ends"),
        (DEVICE + 'participant = "p\\t1"', 4, "'device.participant' should be printable"),
        (DEVICE + "enabled = 'yes'", 4, "'device.enabled' should be true or false"),
        ("[[device]]\nsensor = 'strap'\nunit = ''", 3, "should have at least 1 character"),
        ("\n[[device]]\nsensor = 'strap'", 2, "'device.unit' is missing"),
        ("\n[[device]]\nunit = 'A'", 2, "'device.sensor' is missing; it should be one of box, str"),
        ("[[device]]\nsensor = 'starp'", 2, "but is 'starp' (did you mean 'strap'?"),
        ("[[device]]\nsensor = 3", 2, "should be one of box, strap, but is 3"),
        ("[device]\nsensor = 'strap'", 1, "[[device]] in double brackets"),
        ("device = ['strap']", 1, "a device should be a table"),
    ],
)
def test_a_wrong_value_is_named_with_its_line(
    refuse: Refusal, text: str, line: int, said: str
) -> None:
    error = refuse(text)
    assert error.reason is ConfigReason.WRONG_VALUE
    assert f"settings.toml, line {line}: " in str(error)
    assert said in str(error)
    assert "\n" not in str(error)


def test_a_long_value_is_cut(refuse: Refusal) -> None:
    assert len(str(refuse(f"[log]\nlevel = '{'x' * 500}'")).split("but is ")[1]) < 50


def test_all_problems_are_said_at_once_in_the_order_of_the_file(
    refuse: Refusal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("BIOSENSOR_GATEWAY_LOG__LEVEL", "loud")
    error = refuse(f"{DEVICE}gain = 'x'\n[[device]]\nsensor = 'sock'\n[lsl]\nport_range = 0\nx = 1")
    assert error.reason is ConfigReason.UNKNOWN_KEY
    starts = [line.split(": ")[0].split(", ")[-1] for line in str(error).split("\n")]
    assert starts == [
        "line 4",
        "line 6",
        "line 8",
        "line 9",
        "environment variable BIOSENSOR_GATEWAY_LOG__LEVEL",
    ]


@pytest.mark.parametrize(
    ("extra", "said"),
    [
        ("unit = 'A'\nparticipant = 'p2'", "a second strap with unit 'A'"),
        ("unit = 'B'\nparticipant = 'p1'", "a second strap with participant 'p1' and label ''"),
    ],
)
def test_devices_that_would_share_a_stream_are_refused(
    refuse: Refusal, extra: str, said: str
) -> None:
    error = refuse(f"{DEVICE}participant = 'p1'\n\n[[device]]\nsensor = 'strap'\n{extra}")
    assert error.reason is ConfigReason.WRONG_VALUE
    assert said in str(error)
    assert "line 6: " in str(error)
    assert "(the other is on line 1)" in str(error)


@pytest.mark.parametrize(
    "second",
    [
        "sensor = 'strap'\nunit = 'B'",
        "sensor = 'strap'\nunit = 'A'\nenabled = false",
        "sensor = 'box'\nunit = 'A'\nport = 'COM3'",
    ],
)
def test_devices_that_share_no_stream_are_accepted(load: Loader, second: str) -> None:
    assert len(load(f"{DEVICE}[[device]]\n{second}").devices) == 2


def test_two_labels_make_two_devices_of_one_person(load: Loader) -> None:
    text = "".join(
        f"[[device]]\nsensor = 'strap'\nunit = '{side}'\nparticipant = 'p1'\nlabel = '{side}'\n"
        for side in ("left", "right")
    )
    assert len(load(text).devices) == 2


def test_the_template_loads_as_it_stands(tmp_path: Path) -> None:
    path = tmp_path / "settings.toml"
    path.write_text(template(MODELS), encoding="utf-8")
    assert load_settings(path, MODELS) == GatewaySettings()


def test_the_template_loads_with_every_example_switched_on(tmp_path: Path) -> None:
    text = re.sub(r"^#(?! )", "", template(MODELS), flags=re.MULTILINE)
    path = tmp_path / "settings.toml"
    path.write_text(text, encoding="utf-8")
    settings = load_settings(path, MODELS)
    assert settings.lsl == LslSettings()
    assert settings.power == PowerSettings()
    assert settings.events == EventSettings()
    assert settings.markers == MarkerSettings()
    assert [type(device) for device in settings.devices] == [StrapSettings, BoxSettings]
    assert settings.devices[1] == BoxSettings(sensor="box", unit="0123456789", port="COM3")


def test_the_template_names_and_describes_every_field() -> None:
    text = template(MODELS)
    joined = re.sub(r"\n# ", " ", text)
    sections = (LslSettings, PowerSettings, EventSettings, MarkerSettings, WebMarkerSettings)
    for model in (*sections, StrapSettings, BoxSettings):
        for key, field in model.model_fields.items():
            is_table = isinstance(field.default, BaseModel)
            assert key == "rate" or (f".{key}]\n" if is_table else f"\n#{key} = ") in text
            assert key == "sensor" or is_table or str(field.description) in joined


def test_a_field_that_cannot_be_shown_is_a_fault_of_its_driver() -> None:
    class Bare(DeviceSettings):
        port: str

    with pytest.raises(SpecError, match="'port'"):
        template({"bare": Bare})


def test_the_template_is_written_once(tmp_path: Path) -> None:
    path = tmp_path / "new" / "folder" / "settings.toml"
    write_template(path, MODELS)
    assert load_settings(path, MODELS) == GatewaySettings()
    path.write_text("mine")
    with pytest.raises(ConfigError, match="not overwritten") as caught:
        write_template(path, MODELS)
    assert caught.value.reason is ConfigReason.EXISTS
    assert path.read_text() == "mine"


def test_a_file_in_the_place_of_a_folder_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match=r"cannot make the folder .*SETTINGS") as caught:
        write_template(tmp_path / "file" / "settings.toml", MODELS)
    assert caught.value.reason is ConfigReason.UNREADABLE


def test_the_environment_overrides_the_file(load: Loader, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BIOSENSOR_GATEWAY_LSL__SESSION_ID", "from-env")
    monkeypatch.setenv("BIOSENSOR_GATEWAY_LSL__PORT_RANGE", "64")
    monkeypatch.setenv("BIOSENSOR_GATEWAY_LSL__KNOWN_PEERS", '["a", "b"]')
    settings = load("[lsl]\nsession_id = 'file'\nport_range = 32\n[log]\nlevel = 'error'")
    assert settings.lsl == LslSettings(session_id="from-env", known_peers=("a", "b"), port_range=64)
    assert settings.log.level == "error"


@pytest.mark.parametrize(
    ("variable", "value", "reason", "said"),
    [
        ("LSL__PORT_RANGE", "many", ConfigReason.WRONG_VALUE, "should be an integer"),
        ("LSL__KNOWN_PEERS", "a,b", ConfigReason.WRONG_VALUE, "should be a list in JSON"),
        ("LSL__KNOWN_PEERS", '["a", ""]', ConfigReason.WRONG_VALUE, "should be a host name"),
        ("LSL", "x", ConfigReason.WRONG_VALUE, "'lsl' should be a table"),
        ("LSL", '{"sesion_id": "x"}', ConfigReason.UNKNOWN_KEY, "did you mean 'session_id'?"),
        ("LSL__SESION_ID", "x", ConfigReason.UNKNOWN_KEY, "LSL__SESSION_ID'?"),
        ("LSL_SESSION_ID", "x", ConfigReason.UNKNOWN_KEY, "LSL__SESSION_ID'?"),
        ("LOGS__LEVEL", "x", ConfigReason.UNKNOWN_KEY, "LOG__LEVEL'?"),
        ("DEVICE__0__UNIT", "x", ConfigReason.UNKNOWN_KEY, "no setting has this name"),
        ("LSL__PORT_RANGE__X", "1", ConfigReason.UNKNOWN_KEY, "no setting has this name"),
    ],
)
def test_a_bad_override_is_named_by_its_variable(
    refuse: Refusal,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    *,
    variable: str,
    value: str,
    reason: ConfigReason,
    said: str,
) -> None:
    monkeypatch.setenv(f"BIOSENSOR_GATEWAY_{variable}", value)
    error = refuse("")
    assert error.reason is reason
    assert str(error).startswith(f"environment variable BIOSENSOR_GATEWAY_{variable}: ")
    assert said in str(error)
    assert "\n" not in str(error)
    # Virtual devices need no file, and its absence makes no difference.
    with pytest.raises(ConfigError) as caught:
        load_or_defaults(tmp_path / "none.toml", {})
    assert str(caught.value) == str(error)


def test_a_mistake_in_the_file_is_not_blamed_on_the_environment(
    refuse: Refusal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("BIOSENSOR_GATEWAY_LSL", '{"session_id": "x"}')
    assert "line 2: 'lsl.port_range'" in str(refuse("[lsl]\nport_range = 0"))


@pytest.mark.parametrize("variable", ["DEVICE", "DEVICES", "BIOSENSOR_GATEWAY_DEVICE"])
def test_other_programs_variables_do_not_matter(
    load: Loader, monkeypatch: pytest.MonkeyPatch, variable: str
) -> None:
    monkeypatch.setenv(variable, "/dev/sda")
    assert load(DEVICE).devices[0].unit == "A"


def test_the_paths_follow_their_variables(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert settings_path().name == "settings.toml"
    assert "biosensor-gateway" in settings_path().parts
    assert "biosensor-gateway" in state_folder().parts
    monkeypatch.setenv("BIOSENSOR_GATEWAY_SETTINGS", str(tmp_path / "my.toml"))
    monkeypatch.setenv("BIOSENSOR_GATEWAY_STATE", str(tmp_path / "state"))
    assert settings_path() == tmp_path / "my.toml"
    assert state_folder() == tmp_path / "state"
    monkeypatch.setenv("BIOSENSOR_GATEWAY_STATE", "~/state")
    assert state_folder() == Path.home() / "state"
