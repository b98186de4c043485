#!/bin/sh
# Makes .venv-psychopy, in which the example in PsychoPy runs: make venv-psychopy.
# Needs .uv and .venv, which requirements/install.sh makes. After a change of psychopy.in:
#   .uv/bin/uv pip compile --generate-hashes --no-emit-index-url --no-header --python-version 3.11 \
#       --python-platform x86_64-manylinux_2_28 --no-emit-package psychopy-lib --no-emit-package pyqt6 \
#       --no-emit-package pyqt6-qt6 --no-emit-package pyqt6-sip \
#       tests/examples/psychopy/psychopy.in -o tests/examples/psychopy/psychopy.txt
set -eu
cd "$(dirname "$0")/../../.."
lock=tests/examples/psychopy/psychopy.txt
stamp=.venv-psychopy/.installed
wanted=$(cat "$lock" tests/examples/psychopy/install.sh | sha256sum | cut -d' ' -f1)
if [ -f "$stamp" ] && [ "$(cat "$stamp")" = "$wanted" ]; then exit 0; fi

echo "Setting up .venv-psychopy from $lock ..." >&2
export UV_PYTHON_DOWNLOADS=never UV_SYSTEM_CERTS=1
.uv/bin/uv venv --quiet --clear --python .venv/bin/python .venv-psychopy
.uv/bin/uv pip install --quiet --python .venv-psychopy/bin/python --no-deps --require-hashes -r "$lock"
# Under the GPL, so in no lock of the project: a test program, here and nowhere else. Qt, under the GPL
# as well, is for its dialogs only and is left out.
.uv/bin/uv pip install --quiet --python .venv-psychopy/bin/python --no-deps --require-hashes -r - <<'GPL'
psychopy-lib==2026.2.5 --hash=sha256:56109423bab650312307861edf80d91dea0e5e87c25a0a4e69e36d8e7a2fe6d5 --hash=sha256:961d93e0ef3665f3a4dd29839460db2e7d3b4a4e193ba9b51888c29830d0c115
GPL
echo "$wanted" >"$stamp"
