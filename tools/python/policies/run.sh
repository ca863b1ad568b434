#!/usr/bin/env bash
# Runs a script of this folder with PyTorch, Stable-Baselines3 and TorchRL in an environment of its own (target/venv-policies, 5 GB, made once):
#   tools/python/policies/run.sh train_sb3.py --help
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
top="$(cd "$here/../../.." && pwd)"
venv="$top/target/venv-policies"
if [ $# = 0 ]; then
    sed -n '2,3s/^# //p' "${BASH_SOURCE[0]}"
    ls "$here"/{train,test}_*.py | sed 's:.*/:  :'
    exit 2
fi
script="$here/$1"
if [ ! -f "$script" ]; then
    echo "no script $1; there are $(cd "$here" && echo {train,test}_*.py)" >&2
    exit 2
fi
key="$(sha256sum "$here/requirements.txt" | cut -d' ' -f1)"
if [ "$(cat "$venv/.key" 2>/dev/null)" != "$key" ]; then
    echo "making $venv"
    rm -rf "$venv"
    "${PYTHON:-python3}" -m venv "$venv"
    "$venv/bin/python" -m pip install --quiet --disable-pip-version-check -r "$here/requirements.txt" maturin
    echo "$key" > "$venv/.key"
fi
# The package of this checkout; nothing is compiled that is up to date.
PATH="$venv/bin:$PATH" "$venv/bin/python" -m pip install --quiet --disable-pip-version-check --no-build-isolation "$top/tools/python"
exec "$venv/bin/python" "$script" "${@:2}"
