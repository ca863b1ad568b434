#!/usr/bin/env bash
# Runs the Python tests: makes the environments, builds the programs, runs pytest. Arguments go to the pytest of the clients' and
# readers' tests; without any, those of the Python package (tests/python/package) are run as well; `package` runs them alone.
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
top="$(cd "$here/../.." && pwd)"
"$here/setup.sh"
# All of it at once, as `tests/run` has built it: a part of it would be compiled anew with other features of the libraries.
cargo build --quiet --release --manifest-path "$top/Cargo.toml" --workspace --lib --bins --locked
cd "$here"
if [ $# = 0 ] || [ "$1" = package ]; then
    # What `pip install ./tools/python` installs, without compiling everything anew as a wheel is.
    python="$top/target/venv-package/bin/python"
    site="$("$python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')"
    rm -rf "$site/vigil"
    cp -r "$top/tools/python/vigil" "$site/vigil"
    cp "$top/target/release/lib_vigil.so" "$site/vigil/_vigil.abi3.so"
    # Nobody takes in the sources by accident: their folder has no extension module.
    (cd package && "$python" -m pytest -p no:cacheprovider "${@:2}")
    if [ "${1:-}" = package ]; then exit; fi
fi
exec "$top/target/venv-log/bin/python" -m pytest -p no:cacheprovider --ignore=package "$@"
