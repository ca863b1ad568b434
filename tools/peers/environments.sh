#!/usr/bin/env bash
# Steps per second of our Gymnasium environment beside PyFlyt's, PyBullet's own and MuJoCo's with depth pictures of the same size.
# Makes its own virtual environment under target/ and installs the package of this checkout into it. Arguments: --seconds N, --turns N, --only NAME.
set -euo pipefail
repository=$(cd "$(dirname "$0")/../.." && pwd)
venv=$repository/target/venv-environments
requirements=$repository/tools/peers/requirements-environments.txt
if ! cmp -s "$requirements" "$venv/installed.txt"; then
    echo "installing PyBullet, MuJoCo and others into $venv" >&2
    python3 -m venv "$venv"
    "$venv/bin/pip" install --quiet --disable-pip-version-check -r "$requirements"
    cp "$requirements" "$venv/installed.txt"
fi
"$venv/bin/pip" install --quiet --disable-pip-version-check "$repository/tools/python"
exec "$venv/bin/python" "$repository/tools/peers/environments.py" "$@"
