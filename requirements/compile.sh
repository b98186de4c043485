#!/bin/sh
# Writes all hashed locks again; a locked version stays unless it no longer fits.
#   requirements/compile.sh             keep versions where possible
#   requirements/compile.sh --upgrade   take the newest of everything
set -eu
cd "$(dirname "$0")/.."
# The system's certificates, not uv's own.
export UV_SYSTEM_CERTS=1

# lock LOCK OPTION ...
lock() {
    lock="requirements/$1.txt"
    shift
    .uv/bin/uv pip compile --quiet --generate-hashes --no-emit-index-url --no-header "$@" -o "$lock"
}

# compile LOCK SOURCE [OPTION ...]: for every system and every Python of the project
compile() {
    name="$1"
    shift
    lock "$name" --universal --python-version 3.11 "$@"
}

compile gateway pyproject.toml "$@"
compile ros pyproject.toml --extra ros "$@"
compile dev pyproject.toml --extra ros --extra dev "$@"
# The tests of the node on a newer ROS, with the same versions of all but ROS.
sed -n '/^ros-/d; s/^\([a-z].*==.*\) \\$/\1/p' requirements/dev.txt |
    compile kilted pyproject.toml requirements/kilted.in --constraints - "$@"
# The one Python that is in the installer, so that each package is there in one version.
python=$(sed -n 's/^PYTHON = "\(.*\)"$/\1/p' installer/layout.py)
printf 'pyinstaller>=6.16\ncyclonedx-python-lib>=11\n' |
    lock freeze --python-platform x86_64-pc-windows-msvc --python-version "$python" \
        pyproject.toml - "$@"
# Holds liblsl for Linux on ARM and with an older glibc; nothing else of it is used.
echo 'mne-lsl>=1.14' | compile liblsl - --no-deps "$@"
compile colcon requirements/colcon.in "$@"
echo 'uv>=0.9' | compile uv - "$@"
# Looks for known vulnerabilities of all of these: .github/workflows/advisories.yml.
echo 'pip-audit>=2.9' | compile audit - "$@"
