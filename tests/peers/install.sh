#!/bin/sh
# Makes .venv-peers with other people's clients; see tests/peers/README.md.
# Needs .uv and .venv, which requirements/install.sh makes.
set -eu
cd "$(dirname "$0")/../.."
lock=tests/peers/peers.txt
stamp=.venv-peers/.installed
builds=tests/peers/recordings_build.txt
wanted=$(cat "$lock" "$builds" tests/peers/install.sh | sha256sum | cut -d' ' -f1)
if [ -f "$stamp" ] && [ "$(cat "$stamp")" = "$wanted" ]; then exit 0; fi

if ! [ -x .uv/bin/uv ] || ! [ -x .venv/bin/python ]; then
    echo "Run 'make venv-dev' first: it brings uv and a usable Python." >&2
    exit 1
fi
echo "Setting up .venv-peers from $lock ..." >&2
export UV_PYTHON_DOWNLOADS=never UV_LINK_MODE=copy UV_SYSTEM_CERTS=1
.uv/bin/uv venv --quiet --clear --python .venv/bin/python .venv-peers
# The lock has all but docutils, which comes next.
.uv/bin/uv pip install --quiet --python .venv-peers/bin/python \
    --no-deps --require-hashes --only-binary :all: -r "$lock"
# Under the GPL (of docutils only an editor's file, which its wheel does not have), so in no lock of
# the project: test programs, here and nowhere else.
.uv/bin/uv pip install --quiet --python .venv-peers/bin/python \
    --no-deps --require-hashes --only-binary :all: -r - <<'GPL'
docutils==0.23 --hash=sha256:25d013af9bf23bc1c7b2b093dff4208166c53a94786c9e447808335ef1185fea --hash=sha256:746f5060322511280a1e50eb76846ed6bf2342984b2ac04dc42caa1a8d78799e
godirect==1.2.1 --hash=sha256:79e31737fede29c011945f031b450cc70ad5c49e7beef2e2c35e50dbba814ffd --hash=sha256:d8fac756cd782659a6ae11e0abb1c8d80924bdb2d08d8edffca5fcaa5f8a2201
pyshimmer==1.0.0 --hash=sha256:de8fafbcd43a9dc4749bedb8ccad6461bda709246c8e6bbc4b89e28f38a29893 --hash=sha256:fd5393d6346d04c53d4b64c9c4268415f48492828b467b4ab1ee0d5948b83e50
GPL
# Also under the GPL. For its recordings only, which its wheel does not have.
.uv/bin/uv pip install --quiet --python .venv-peers/bin/python --build-constraints "$builds" \
    --no-deps --require-hashes --no-binary systole -r - <<'RECORDINGS'
systole==0.3.1 --hash=sha256:9bc145f7b87caa57b53e45f34276bcfefec101bc1c662e4e104f53fdfa5a405a
RECORDINGS
echo "$wanted" >"$stamp"
