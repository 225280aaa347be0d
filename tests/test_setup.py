import shutil
import subprocess
import sys
from pathlib import Path
import pytest

ROOT = Path(__file__).resolve().parent.parent
UTILITIES = (
    "awk bash cat chmod cksum cp cut df dirname env find grep head ls mkdir mv rm rmdir sed tail touch tr true".split()
)
# `-m pip` brings a uv, which makes a .venv of links and "installs" by noting what it was asked for.
PYTHON = """#!/bin/bash
case "$*" in
    *version_info\\ \\<*) exec {python} -c 'import sys; sys.exit(int("{version}".split(".")[1]) < 11)' ;;
    *version_info*) echo {version} ;;
    *sys.executable*) echo "$0" ;;
    "-m pip --version") {has_pip} ;;
    "-m pip install "*--target*) {has_uv} && mkdir -p .venv/.setup/uv/bin && cp uv .venv/.setup/uv/bin/uv ;;
    "-m pip config list") echo "global.index-url='file:///index'"; echo "global.find-links='/a /b'" ;;
    "-m pip "*install*)
        echo "pip $*" >> asked
        [ ! -f .venv/.setup/lock ] || echo "installs $(cat .venv/.setup/lock)" >> asked ;;
    "-m venv --without-pip .venv") ./uv venv ;;
    "-m venv "*) exit 1 ;;
esac
"""
UV = """#!/bin/bash
echo "uv $* $UV_DEFAULT_INDEX $UV_FIND_LINKS $UV_CACHE_DIR" >> asked
case "$1" in
    venv)
        mkdir -p .venv/bin && touch .venv/pyvenv.cfg
        printf '#!/bin/bash\\n[ ! -f old ]\\n' > .venv/bin/python && chmod +x .venv/bin/python ;;
    pip)
        echo "   Downloading numpy (16.1MiB)"
        if [ -f fault ] && [[ "$*" == *-r* ]]; then cat fault; exit 2; fi ;;
esac
"""


class Checkout:
    def __init__(self, folder, version="3.11.7", has_pip=True, has_uv=True):
        self.folder, self.bin, self.venv = folder / "checkout", folder / "bin", folder / "checkout" / ".venv"
        (self.folder / "tools").mkdir(parents=True)
        self.bin.mkdir()
        for name in ("tools/setup.sh", "tools/make_venv"):
            shutil.copy(ROOT / name, self.folder / name)
        for name in ("requirements.lock", "requirements-test.lock", "pyproject.toml"):
            (self.folder / name).write_text("numpy==2.4.6\nuv==0.13.9\n")
        for name in UTILITIES:
            (self.bin / name).symlink_to(str(shutil.which(name)))
        words = {"python": sys.executable, "version": version}
        words |= {"has_pip": str(has_pip).lower(), "has_uv": str(has_uv).lower()}
        self._program(self.bin / "python3", PYTHON.format(**words))
        self._program(self.folder / "uv", UV)

    def _program(self, path, text):
        path.write_text(text)
        path.chmod(0o755)

    def set_up(self, group="run", **environment):
        """Return the exit status and what was printed."""
        home = {"HOME": str(self.folder.parent), "PATH": str(self.bin)}
        command = ["bash", "-c", f"source tools/setup.sh {group}; echo ready"]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
        done = subprocess.run(command, cwd=self.folder, env=home | environment, check=False, **pipes)
        return done.returncode, done.stdout

    def asked(self):
        """Return what the installers were asked for since the last time."""
        asked = self.folder / "asked"
        text = asked.read_text() if asked.exists() else ""
        asked.unlink(missing_ok=True)
        return text

    def refused(self, **environment):
        """Return the one line that says why nothing was set up; nothing unfinished is left."""
        status, told = self.set_up(**environment)
        assert status == 2, told
        assert not (self.venv / ".hickory-setup-run").exists()
        *before, line = told.splitlines()
        assert line.startswith("set-up: ")
        assert all(one.startswith(("  ", "setting up")) for one in before)
        return line


@pytest.fixture
def checkout(tmp_path):
    return Checkout(tmp_path)


def test_each_phase_is_said_and_done_once(checkout):
    status, told = checkout.set_up()
    assert (status, told.count("done in")) == (0, 3), told
    assert "install 2 packages of requirements.lock with uv" in told
    assert "Downloading numpy (16.1MiB)" in told
    asked = checkout.asked()
    assert "-r requirements.lock" in asked
    assert "file:///index /a,/b" in asked, "uv asks where pip does"
    assert not (checkout.venv / ".setup").exists()
    assert checkout.set_up() == (0, "ready\n")
    assert checkout.asked() == ""


def test_tests_add_their_packages_to_the_same_environment(checkout):
    checkout.set_up("run")
    checkout.asked()
    assert "updating .venv" in checkout.set_up("tests")[1]
    asked = checkout.asked()
    assert "-r requirements-test.lock" in asked
    assert "uv venv" not in asked
    assert checkout.set_up("run") == checkout.set_up("tests") == (0, "ready\n")


def test_pip_installs_where_uv_cannot_be_fetched(tmp_path):
    checkout = Checkout(tmp_path, has_uv=False)
    assert checkout.set_up()[0] == 0
    asked = checkout.asked()
    assert "pip -m pip --python .venv/bin/python install" in asked
    assert "installs numpy==2.4.6\n" in asked, "and no uv"


def test_an_older_python_is_named(tmp_path):
    line = Checkout(tmp_path, version="3.10.13").refused()
    assert line == (
        "set-up: Python 3.11 or newer is needed, and the newest on PATH is 3.10.13. Install one, then run this again"
    )
    assert not (tmp_path / "checkout" / ".venv").exists()


def test_a_python_without_pip_and_venv_is_refused(tmp_path):
    checkout = Checkout(tmp_path, has_pip=False)
    assert "has neither pip nor venv. Install them" in checkout.refused()
    shutil.copy(checkout.folder / "uv", checkout.bin / "uv")
    assert checkout.set_up()[0] == 0, "a uv of the system does"


@pytest.mark.parametrize(("fault", "said"), [
    ("error: failed to write: No space left on device (os error 28)", "the disk is full while installing packages"),
    ("error: Failed to fetch numpy\n  cause: Connection reset", "does not answer while installing packages (Conn"),
    ("error: Read-only file system (os error 30)", "a folder cannot be written while installing packages"),
    ("error: numpy has no wheel", "an error while installing packages: numpy has no wheel"),
], ids=("disk", "network", "folder", "other"))  # fmt: skip
def test_a_failed_installation_is_explained_and_begun_again(checkout, fault, said):
    (checkout.folder / "fault").write_text(fault)
    # pip, which comes second, fails as well.
    python = checkout.bin / "python3"
    python.write_text(python.read_text().replace('"-m pip "*install*)', '"-m pip "*install*) exit 1 ;; none)'))
    assert said in checkout.refused()
    assert not checkout.venv.exists()
    (checkout.folder / "fault").unlink()
    assert checkout.set_up()[0] == 0


def test_what_cannot_be_kept_goes_into_the_environment(checkout):
    blocked = checkout.folder / "pyproject.toml"
    status, told = checkout.set_up(XDG_CACHE_HOME=str(blocked))
    assert status == 0
    assert f"{blocked}/uv cannot be written: downloads are not kept" in told
    assert str(checkout.venv / ".setup" / "cache") in checkout.asked()


def test_an_interrupted_set_up_is_begun_again(checkout):
    checkout.set_up()
    (checkout.venv / ".hickory-setup-run").unlink()
    (checkout.venv / ".setup").mkdir()
    (checkout.venv / ".setup" / "new").touch()
    (checkout.venv / "half").touch()
    assert "setting up .venv again: it is unfinished" in checkout.set_up()[1]
    assert not (checkout.venv / "half").exists()


def test_an_old_environment_is_updated_or_made_again(checkout):
    checkout.set_up()
    checkout.asked()
    (checkout.folder / "requirements.lock").write_text("numpy==2.5\nuv==0.13.9\n")
    assert "updating .venv to requirements.lock" in checkout.set_up()[1]
    assert "uv venv" not in checkout.asked()
    (checkout.folder / "old").touch()
    assert "setting up .venv again: its Python is older than 3.11, or gone" in checkout.set_up()[1]
    assert "uv venv" in checkout.asked()


def test_a_moved_checkout_makes_its_environment_again(checkout):
    checkout.set_up()
    moved = checkout.folder.with_name("moved")
    checkout.folder.rename(moved)
    checkout.folder, checkout.venv = moved, moved / ".venv"
    assert "setting up .venv again: it was made in another folder" in checkout.set_up()[1]


def test_an_environment_that_the_user_made_is_completed(checkout):
    checkout.set_up()
    (checkout.venv / ".hickory-setup-run").unlink()
    (checkout.venv / "own").touch()
    assert "updating .venv to requirements.lock" in checkout.set_up()[1]
    assert (checkout.venv / "own").exists()


def test_a_folder_of_the_user_is_left_alone(checkout):
    checkout.venv.mkdir()
    (checkout.venv / "thesis.txt").touch()
    assert "is not a virtual environment. Move it away" in checkout.refused()
    assert (checkout.venv / "thesis.txt").exists()
