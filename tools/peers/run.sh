#!/usr/bin/env bash
# Compares our programs with PyTorch, ONNX Runtime, tract, shap, captum and ART, side by side (docs/peers.md).
# Makes its own virtual environment under target/ (5 GB: PyPI's torch brings its GPU libraries). --help for what can be chosen.
set -euo pipefail
source "$(dirname "$0")/venv.sh" peers requirements.txt "PyTorch and others"
# Both outside the workspace: nothing else needs them, and the crates of tract alone, 115, take minutes.
cargo build --release --locked --manifest-path "$repository/tools/peers/Cargo.toml" --target-dir "$repository/target"
cargo build --release --locked --manifest-path "$repository/tools/peers/tract/Cargo.toml" --target-dir "$repository/target/tract"
exec "$venv/bin/python" "$repository/tools/peers/compare.py" --tract "$repository/target/tract/release/vigil-peers-tract" "$@"
