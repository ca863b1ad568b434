#!/usr/bin/env bash
# Exports a frozen actor to ONNX: actor.onnx and actor.onnx.json beside it. Makes its own virtual environment under target/.
# Usage: tools/peers/export.sh [ACTOR.safetensors]        default: the built-in actor
set -euo pipefail
repository=$(cd "$(dirname "$0")/../.." && pwd)
[[ "${1:-}" == -h || "${1:-}" == --help ]] && { sed -n '2,3p' "$0" | cut -c3-; exit 0; }
venv=$repository/target/venv-onnx
requirements=$repository/tools/peers/requirements-onnx.txt
if ! cmp -s "$requirements" "$venv/installed.txt"; then
    python3 -m venv "$venv"
    "$venv/bin/pip" install --quiet --disable-pip-version-check -r "$requirements"
    cp "$requirements" "$venv/installed.txt"
fi
exec "$venv/bin/python" "$repository/tools/peers/export_onnx.py" "$@"
