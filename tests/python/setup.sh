#!/usr/bin/env bash
# Makes one virtual environment per requirements-NAME.txt as target/venv-NAME at the top of the checkout.
# Repeated runs cost nothing: an environment is made anew only when its requirements or the Python version changed.
set -euo pipefail
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
top="$(cd "$here/../.." && pwd)"
python="${PYTHON:-python3}"
mkdir -p "$top/target"
# One pip for all environments, and what it installs is compiled where it is imported: otherwise it takes 2.6 times as long.
pip="$top/target/venv-pip/bin/python"
for requirements in "$here"/requirements-*.txt; do
    name="$(basename "$requirements" .txt)"
    name="${name#requirements-}"
    venv="$top/target/venv-$name"
    key="$( { "$python" --version; cat "$requirements"; } | sha256sum | cut -d' ' -f1)"
    if [ -f "$venv/.key" ] && [ "$(cat "$venv/.key")" = "$key" ]; then
        continue
    fi
    echo "python: making target/venv-$name"
    rm -rf "$venv"
    "$pip" -m pip --version >/dev/null 2>&1 || "$python" -m venv --clear "$top/target/venv-pip"
    "$python" -m venv --without-pip "$venv"
    # Options that a requirements file cannot hold stand in its first line.
    read -r -a options <<< "$(sed -n '1s/^# pip: //p' "$requirements")"
    "$pip" -m pip --python "$venv/bin/python" install --no-compile --quiet --disable-pip-version-check "${options[@]}" -r "$requirements"
    # Written last: an interrupted install is done again.
    echo "$key" > "$venv/.key"
done
