# Sourced with a name, its list of packages and what to say: sets `repository`, and `venv` to a virtual environment that has them.
repository=$(cd "$(dirname "$0")/../.." && pwd)
venv=$repository/target/venv-$1
requirements=$repository/tools/peers/$2
if ! cmp -s "$requirements" "$venv/installed.txt"; then
    [ -z "${3:-}" ] || echo "installing $3 into $venv" >&2
    python3 -m venv "$venv"
    "$venv/bin/pip" install --quiet --disable-pip-version-check -r "$requirements"
    cp "$requirements" "$venv/installed.txt"
fi
