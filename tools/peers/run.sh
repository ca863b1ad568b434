#!/usr/bin/env bash
# Compares our programs with PyTorch, ONNX Runtime, tract, shap, captum and ART, side by side (docs/peers.md).
# Makes its own virtual environment under target/ (5 GB: PyPI's torch brings its GPU libraries). --help for what can be chosen.
set -euo pipefail
repository=$(cd "$(dirname "$0")/../.." && pwd)
venv=$repository/target/venv-peers
requirements=$repository/tools/peers/requirements.txt
if ! cmp -s "$requirements" "$venv/installed.txt"; then
    echo "installing PyTorch and others into $venv" >&2
    python3 -m venv "$venv"
    "$venv/bin/pip" install --quiet --disable-pip-version-check -r "$requirements"
    cp "$requirements" "$venv/installed.txt"
fi
# Both outside the workspace: nothing else needs them, and the crates of tract alone, 115, take minutes.
cargo build --release --locked --manifest-path "$repository/tools/peers/Cargo.toml" --target-dir "$repository/target"
cargo build --release --locked --manifest-path "$repository/tools/peers/tract/Cargo.toml" --target-dir "$repository/target/tract"
exec "$venv/bin/python" "$repository/tools/peers/compare.py" --tract "$repository/target/tract/release/vigil-peers-tract" "$@"
