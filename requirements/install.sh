#!/bin/sh
# Makes .venv, or another folder, and installs one hashed lock into it, then this project (editable).
#   requirements/install.sh LOCK [FOLDER]        e.g. requirements/install.sh ros
# Needs a Python 3.11-3.14 with venv; uv itself comes from PyPI by its own lock.
set -eu
cd "$(dirname "$0")/.."
lock="requirements/$1.txt"
venv="${2:-.venv}"
stamp="$venv/.installed-$1"
wanted=$(cat "$lock" pyproject.toml | sha256sum | cut -d' ' -f1)
if [ -f "$stamp" ] && [ "$(cat "$stamp")" = "$wanted" ]; then exit 0; fi

echo "Setting up $venv from $lock ..." >&2
# A name on PATH proves nothing: version-manager shims exist for Pythons that do not run.
usable='import ensurepip, sys, venv; raise SystemExit(not (3, 11) <= sys.version_info[:2] <= (3, 14))'
python=
for candidate in "${PYTHON:-python3}" python3.12 python3.11 python3.13 python3.14 /usr/bin/python3; do
    if "$candidate" -c "$usable" >/dev/null 2>&1; then python=$candidate; break; fi
done
if [ -z "$python" ]; then
    echo "No Python 3.11-3.14 with venv found: install one (Debian: apt install python3-venv) or set PYTHON." >&2
    exit 1
fi

if ! [ -x .uv/bin/uv ]; then
    "$python" -m venv --clear .uv
    bring_uv() { .uv/bin/pip install --quiet --require-hashes -r requirements/uv.txt; }
    # pip has certificates of its own before 24.2, which a proxy that looks into connections has not.
    certificates=$("$python" -c 'import ssl; at = ssl.get_default_verify_paths(); print(at.cafile or at.capath or "")')
    bring_uv 2>/dev/null || PIP_CERT="${PIP_CERT:-$certificates}" bring_uv
fi
# The system's certificates, too, not uv's own.
export UV_PYTHON_DOWNLOADS=never UV_LINK_MODE=copy UV_SYSTEM_CERTS=1
cache=$(.uv/bin/uv cache dir)
# Where the home folder cannot be written, nobody else shares it.
mkdir -p "$cache" 2>/dev/null && [ -w "$cache" ] || export UV_CACHE_DIR="$PWD/.uv/cache"
[ -x "$venv/bin/python" ] || .uv/bin/uv venv --quiet --python "$("$python" -c 'import sys; print(sys.executable)')" "$venv"
.uv/bin/uv pip install --quiet --python "$venv/bin/python" --require-hashes -r "$lock"
.uv/bin/uv pip install --quiet --python "$venv/bin/python" --no-deps --editable .
# Python before 3.13 reads these lines in the locale's encoding, and stops at a path with other letters.
for lines in "$venv"/lib/python3.*/site-packages/*biosensor_gateway*.pth; do
    at="$PWD" awk '{
        if (index($0, ENVIRON["at"] "/") == 1) $0 = "../../../.." substr($0, length(ENVIRON["at"]) + 1)
        print
    }' "$lines" >"$lines.new"
    mv "$lines.new" "$lines"
done
echo "$wanted" >"$stamp"
