#!/bin/sh
# Makes .venv-peers with the clients of tests/peers/peers.txt; see tests/peers/README.md.
# Needs .uv and .venv, which requirements/install.sh makes.
set -eu
cd "$(dirname "$0")/../.."
lock=tests/peers/peers.txt
stamp=.venv-peers/.installed
wanted=$(sha256sum <"$lock" | cut -d' ' -f1)
if [ -f "$stamp" ] && [ "$(cat "$stamp")" = "$wanted" ]; then exit 0; fi

if ! [ -x .uv/bin/uv ] || ! [ -x .venv/bin/python ]; then
    echo "Run 'make venv-dev' first: it brings uv and a usable Python." >&2
    exit 1
fi
echo "Setting up .venv-peers from $lock ..." >&2
export UV_PYTHON_DOWNLOADS=never UV_LINK_MODE=copy
.uv/bin/uv venv --quiet --clear --python .venv/bin/python .venv-peers
.uv/bin/uv pip install --quiet --python .venv-peers/bin/python \
    --require-hashes --only-binary :all: -r "$lock"
echo "$wanted" >"$stamp"
