#!/usr/bin/env bash
# Steps per second of our Gymnasium environment beside PyFlyt's, PyBullet's own and MuJoCo's with depth pictures of the same size.
# Makes its own virtual environment under target/ and installs the package of this checkout into it. Arguments: --seconds N, --turns N, --only NAME.
set -euo pipefail
source "$(dirname "$0")/venv.sh" environments requirements-environments.txt "PyBullet, MuJoCo and others"
"$venv/bin/pip" install --quiet --disable-pip-version-check "$repository/tools/python"
exec "$venv/bin/python" "$repository/tools/peers/environments.py" "$@"
