#!/usr/bin/env bash
# Runs the Python tests: makes the environments, builds the programs, runs pytest. Arguments go to pytest.
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
top="$(cd "$here/../.." && pwd)"
"$here/setup.sh"
cargo build --quiet --release --manifest-path "$top/Cargo.toml" -p vigil-tools
cd "$here"
exec "$top/target/venv-log/bin/python" -m pytest -p no:cacheprovider "$@"
