#!/usr/bin/env bash
# Exports a frozen actor to ONNX: actor.onnx and actor.onnx.json beside it. Makes its own virtual environment under target/.
# Usage: tools/peers/export.sh [ACTOR.safetensors]        default: the built-in actor
set -euo pipefail
[[ "${1:-}" == -h || "${1:-}" == --help ]] && { sed -n '2,3p' "$0" | cut -c3-; exit 0; }
source "$(dirname "$0")/venv.sh" onnx requirements-onnx.txt
exec "$venv/bin/python" "$repository/tools/peers/export_onnx.py" "$@"
