#!/usr/bin/env bash
# Runs the Python tests: makes the environments, builds the programs, runs pytest. Arguments go to the pytest of the clients' and
# readers' tests; without any, those of the Python package (tests/python/package) are run as well; `package` runs them alone.
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
top="$(cd "$here/../.." && pwd)"
export top
"$here/setup.sh"
# All of it at once, as `tests/run` has built it: a part of it would be compiled anew with other features of the libraries.
programs=(--workspace --lib --bins --example sample_log --example vigil_depth)
# Not asked of cargo a second time, which would wait for the checks beside it.
[ -n "${VIGIL_IS_BUILT:-}" ] || cargo build --quiet --release --manifest-path "$top/Cargo.toml" "${programs[@]}" --locked
cd "$here"

test_files() { "$top/target/venv-log/bin/python" -m pytest -p no:cacheprovider --ignore=package "$@"; }
# Nobody takes in the sources by accident: their folder has no extension module. It computes all the time; flights must not wait for it.
test_package() { cd package && nice -n 5 "$top/target/venv-package/bin/python" -m pytest -p no:cacheprovider "$@"; }

if [ $# = 0 ] || [ "$1" = package ]; then
    # What `pip install ./tools/python` installs, without compiling everything anew as a wheel is.
    python="$top/target/venv-package/bin/python"
    site="$("$python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')"
    rm -rf "$site/vigil"
    cp -r "$top/tools/python/vigil" "$site/vigil"
    cp "$top/target/release/lib_vigil.so" "$site/vigil/_vigil.abi3.so"
fi
if [ "${1:-}" = package ]; then
    test_package "${@:2}"
    exit
fi
if [ $# != 0 ]; then
    test_files "$@"
    exit
fi

# The tests wait for vehicles that fly in real time more than they compute: some files are run at once, each by a pytest of its own.
at_once=4
# The slowest first, then whatever is not named. There are nine vehicles (stack.py): the first three files have three each, and
# what stands behind them needs none until those have landed.
files=(test_ground_plans.py test_clients.py test_ground_habits.py test_signing.py package test_flood.py test_depth_publisher.py)
files+=(test_mavsdk_calls.py test_scripts.py test_mavproxy.py test_ground_services.py)
for file in test_*.py; do
    if [[ " ${files[*]} " != *" $file "* ]]; then files+=("$file"); fi
done

# Runs a file, or the package, and then shows what it said, undisturbed by the others.
one() {
    local said="$scratch/$1" code=0
    if [ "$1" = package ]; then test_package; else test_files "$1"; fi >"$said" 2>&1 || code=$?
    flock "$scratch" cat "$said"
    return "$code"
}
scratch="$(mktemp -d)"
trap 'rm -rf "$scratch"' EXIT
export scratch
export -f one test_files test_package
printf '%s\n' "${files[@]}" | xargs -P "$at_once" -I{} bash -c 'one {}' || {
    echo "some Python tests failed: see above" >&2
    exit 1
}
