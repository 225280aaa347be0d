# Sourced by the other tools: makes .venv with exactly the locked versions, and does nothing when that is there already.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

stamp=.venv/.hickory-setup
want=$(cat requirements.lock pyproject.toml | cksum)
if [ ! -f "$stamp" ] || [ "$(cat "$stamp")" != "$want" ]; then
    python=""
    for candidate in python3.11 python3.12 python3.13 python3; do
        if command -v "$candidate" >/dev/null && "$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 11))'; then
            python=$candidate
            break
        fi
    done
    if [ -z "$python" ]; then
        echo "hickory-stream needs Python 3.11 or newer; none was found on PATH" >&2
        exit 2
    fi
    echo "setting up .venv with $("$python" --version) (once; about a minute)" >&2
    [ -x .venv/bin/python ] || "$python" -m venv .venv
    .venv/bin/python -m pip install --quiet --disable-pip-version-check -r requirements.lock
    .venv/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
    # Compiled kernels are kept in the user's caches: the first real run then starts at once.
    warm=$(mktemp -d)
    .venv/bin/hickory-stream play recordings/demo.mcap --frames 36 --out "$warm/map" --viewer none --json \
        --set mapper.run.shape_cache=false >/dev/null 2>&1 || true
    .venv/bin/hickory-stream align "$warm/map" "$warm/map" >/dev/null 2>&1 || true
    rm -rf "$warm"
    echo "$want" > "$stamp"
fi
