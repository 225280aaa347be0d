# Sourced by the other tools with the packages that they need: `run` (requirements.lock: the product) or `tests`
# (requirements-test.lock: everything). Brings .venv up to that lock, and does nothing where it is.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

# A moved checkout has another stamp: the scripts of a .venv name its folder.
setup_stamp="$(cat requirements*.lock pyproject.toml | cksum) $(pwd -P)"
if [ "$(cat ".venv/.hickory-setup-$1" 2>/dev/null)" != "$setup_stamp" ] || ! .venv/bin/python -Sc '' 2>/dev/null; then
    tools/make_venv "$1" "$setup_stamp"
fi
