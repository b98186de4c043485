"""Debian for 64-bit ARM in a folder, whose programs qemu runs, with a wheel installed.

Needs root, mmdebstrap and a mirror of Debian. qemu of Debian 12 knows no IP_MULTICAST_IF, without
which liblsl finds no stream, so a newer one is unpacked, and installed nowhere.
"""

from __future__ import annotations

import os
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Generator, Sequence
from contextlib import closing, contextmanager, suppress
from pathlib import Path

from tests.wheel.conftest import LOCK, ROOT, build, uv

BINFMT = Path("/proc/sys/fs/binfmt_misc")
PLATFORM, PYTHON, RELEASE = "aarch64-manylinux_2_36", "3.11", "bookworm"
QEMU_RELEASE = "trixie"
HOME = "home"
DEV_LOCK = ROOT / "requirements" / "dev.txt"
TEST_TOOLS = (
    *("pytest", "pytest-asyncio", "pytest-timeout", "pytest-xdist", "hypothesis"),
    "pyxdf",
)
KEYRING = "/usr/share/keyrings/debian-archive-keyring.gpg"
# Magic and mask of ELF files for this processor.
MAGIC = r"\x7f\x45\x4c\x46\x02\x01\x01\x00\x00\x00\x00\x00\x00\x00\x00\x00\x02\x00\xb7\x00"
MASK = r"\xff\xff\xff\xff\xff\xff\xff\x00\xff\xff\xff\xff\xff\xff\xff\xff\xfe\xff\xff\xff"
# The folder has no coreutils.
_IN_FOLDER = (
    "import os, sys; os.chdir(sys.argv[1]); os.execv(sys.executable, ['python3', *sys.argv[2:]])"
)
LIMIT_S = 3600.0
"""Emulation takes ten times as long, and more on a busy computer."""


def _run(*command: str | Path, folder: Path | None = None, **variables: str) -> str:
    done = subprocess.run(
        command, capture_output=True, text=True, cwd=folder, env=os.environ | variables, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def mirror() -> str:
    """Return where this computer takes Debian's packages from."""
    sources = ["$(SITE)", "$(RELEASE)"]
    listed = _run("apt-get", "indextargets", "--format", " ".join(sources), "Created-By: Packages")
    (site, _), *_ = (each.split() for each in listed.splitlines() if each.endswith(f" {RELEASE}"))
    return site


def _qemu(folder: Path, mirror: str) -> Path:
    for each in ("lists/partial", "archives/partial"):
        (folder / each).mkdir(parents=True)
    line = f"deb [signed-by={KEYRING}] {mirror} {QEMU_RELEASE} main\n"
    (folder / "sources.list").write_text(line, encoding="utf-8")
    (folder / "apt.conf").write_text(
        f'Dir::Etc::sourcelist "{folder}/sources.list";\nDir::Etc::sourceparts "/dev/null";\n'
        f'Dir::State::lists "{folder}/lists";\nDir::Cache "{folder}";\n'
        f'Dir::Cache::archives "{folder}/archives";\nAPT::Sandbox::User "root";\n',
        encoding="utf-8",
    )
    config = str(folder / "apt.conf")
    _run("apt-get", "update", "--quiet", APT_CONFIG=config)
    _run("apt-get", "download", "--quiet", "qemu-user", folder=folder, APT_CONFIG=config)
    (package,) = folder.glob("qemu-user_*.deb")
    _run("dpkg", "-x", package, folder / "qemu")
    return folder / "qemu/usr/bin/qemu-aarch64"


@contextmanager
def _registered(qemu: Path) -> Generator[None]:
    """Have the kernel run programs for ARM by qemu."""
    # F: it opens qemu now, so that the folder need not have it.
    if not (BINFMT / "register").exists():
        _run("mount", "-t", "binfmt_misc", "binfmt_misc", BINFMT)
    name = f"biosensor-gateway-{os.getpid()}"
    # F: the kernel opens qemu now, so that it need not be in the folder.
    (BINFMT / "register").write_text(f":{name}:M::{MAGIC}:{MASK}:{qemu}:OF", encoding="ascii")
    try:
        yield
    finally:
        (BINFMT / name).write_text("-1", encoding="ascii")


class Arm64:
    """The folder with the product, and how its programs are run."""

    def __init__(self, root: Path) -> None:
        self.root, self.home = root, root / HOME
        self._started: list[subprocess.Popen[str]] = []

    def close(self) -> None:
        """End what still runs there, also what its programs have started."""
        for each in Path("/proc").glob("[0-9]*"):
            # It may end meanwhile.
            with suppress(OSError):
                if (each / "root").readlink() == self.root:
                    os.kill(int(each.name), signal.SIGKILL)
        for each in self._started:
            each.wait(LIMIT_S)

    def start(self, *arguments: str) -> subprocess.Popen[str]:
        """Start the product's program there."""
        return self.start_python("/site/bin/biosensor-gateway", *arguments)

    def run(self, *arguments: str, codes: Sequence[int] = (0,)) -> str:
        """Run it to its end; return what it has said."""
        return self.ended(self.start(*arguments), codes)

    def start_python(
        self, *arguments: str, folder: str = f"/{HOME}", **variables: str
    ) -> subprocess.Popen[str]:
        """Start Python there."""
        known = {
            "HOME": f"/{HOME}",
            "PATH": "/usr/bin:/bin",
            "LANG": "C.UTF-8",
            "PYTHONPATH": "/site",
            "LSLAPICFG": "/lsl.cfg",
            "PYTHON_KEYRING_BACKEND": os.environ["PYTHON_KEYRING_BACKEND"],
            "BIOSENSOR_GATEWAY_BROADCAST": "127.0.0.1",
            **variables,
        }
        mounts = f"mount -t proc proc {self.root}/proc && mount --rbind /dev {self.root}/dev"
        python = ["/usr/bin/python3", "-c", _IN_FOLDER, folder, *arguments]
        program = ["env", "-i", *(f"{name}={value}" for name, value in known.items())]
        program += ["/usr/sbin/chroot", str(self.root), *python]
        inside = f"{mounts} && exec {shlex.join(program)}"
        started = subprocess.Popen(
            ["unshare", "--mount", "--propagation", "private", "sh", "-c", inside],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self._started.append(started)
        return started

    @staticmethod
    def ended(process: subprocess.Popen[str], codes: Sequence[int] = (0,)) -> str:
        """Wait for the end of a program; return what it has said."""
        said, _ = process.communicate(timeout=LIMIT_S)
        assert "Traceback" not in said, said
        assert process.returncode in codes, said
        return said


@contextmanager
def installed(folder: Path) -> Generator[Arm64]:
    """Build the wheel, and install it and all that it needs, by hash, in a Debian for ARM."""
    pip = ROOT / ".uv" / "bin" / "python"
    _run(pip, "-m", "installer.liblsl", folder, folder=ROOT)
    wheel = build(ROOT, folder / "built", "--wheel", liblsl=folder / "aarch64")
    root, site_of_debian = folder / "root", mirror()
    (folder / "apt").mkdir()
    qemu = _qemu(folder / "apt", site_of_debian)
    packages = "python3,ca-certificates,libstdc++6"
    _run(
        *("mmdebstrap", "--quiet", "--arch=arm64", "--variant=extract"),
        *(f"--include={packages}", RELEASE, root, site_of_debian),
    )
    site = ("--target", root / "site", "--python-platform", PLATFORM, "--python-version", PYTHON)
    uv("pip", "install", "--quiet", *site, "--only-binary=:all:", "--require-hashes", "-r", LOCK)
    uv("pip", "install", "--quiet", *site, "--no-deps", wheel)
    tools = ("--target", root / "tools", *site[2:], "--constraint", DEV_LOCK)
    uv("pip", "install", "--quiet", *tools, "--only-binary=:all:", *TEST_TOOLS)
    repository = root / "repository"
    _run("git", "clone", "--quiet", ROOT, repository)
    for each in ("proc", "dev", "sys", "tmp", "run", HOME):
        (root / each).mkdir(exist_ok=True)
    (root / "lsl.cfg").write_bytes(Path(os.environ["LSLAPICFG"]).read_bytes())
    with _registered(qemu), closing(Arm64(root)) as debian:
        yield debian
    shutil.rmtree(root)


def needs() -> str:
    """Say what is missing here; empty if nothing is."""
    if sys.platform != "linux" or os.uname().machine != "x86_64":
        return "an x86-64 Linux emulates it"
    if os.geteuid() != 0:
        return "only root can make a Debian in a folder"
    missing = [each for each in ("mmdebstrap", "unshare") if not _is_there(each)]
    return f"{', '.join(missing)} is missing" if missing else ""


def _is_there(program: str) -> bool:
    return any((Path(each) / program).is_file() for each in os.environ["PATH"].split(os.pathsep))
