import ast
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from importlib import metadata
from pathlib import Path
import cv2
import pytest
from packaging.requirements import Requirement
from hickory_stream.map_folder.saved_map import open_map
from tools.platforms import obstacle

ROOT = Path(__file__).resolve().parent.parent
# Without the checkout on the path of modules, as for a person who installs the wheel.
ENVIRONMENT = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_the_wheel_makes_and_maps_a_log_outside_the_checkout(tmp_path):
    wheels, venv, work = tmp_path / "wheels", tmp_path / "venv", tmp_path / "work"
    work.mkdir()
    _run(
        sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", wheels, _clean_copy(tmp_path), cwd=work
    )
    [wheel] = wheels.glob("*.whl")
    _run(sys.executable, "-m", "venv", "--without-pip", venv, cwd=work)
    install = ("-m", "pip", "--python", venv / "bin" / "python", "install", "--quiet", "--no-deps", "--no-index")
    _run(sys.executable, *install, wheel, cwd=work)
    [site] = venv.glob("lib/python*/site-packages")
    _link_what_it_needs(site)
    made = _check_demo(_run(venv / "bin" / "hickory-stream", "demo", "--seconds", 2, "--json", cwd=work), work)
    summary = json.loads(_run(venv / "bin" / "hickory-stream", "inspect", made, "--json", cwd=work))
    assert summary["digest"] == open_map(work / made).manifest.digest
    measured = _run(
        venv / "bin" / "hickory-stream", "evaluate", made, "--truth", "hickory-demo/room.truth", "--json", cwd=work
    )
    assert json.loads(measured)
    told = "import importlib.metadata as m; print(*m.metadata('hickory-stream').get_all('Classifier'), sep='|')"
    assert "Programming Language :: Python :: 3.11|" in _run(venv / "bin" / "python", "-c", told, cwd=work)
    where = _run(
        venv / "bin" / "python", "-c", "import hickory_stream, players; print(hickory_stream.__file__)", cwd=work
    )
    assert str(venv) in where, "the installed package was used, not the checkout"


def _check_demo(told, work):
    """Return the map that `demo` made: its objects have all layers, and a log with truth and pictures are beside it."""
    demo = json.loads(told.splitlines()[-1])
    folder = Path("hickory-demo")
    assert demo["map"] == str(folder / "map")
    saved = open_map(work / demo["map"])
    assert saved.manifest.finished_cleanly
    assert sum(tracked.shape is not None for tracked in saved.snapshot.objects) >= 5
    assert (work / folder / "room.truth" / "truth.json").is_file()
    assert len(demo["pictures"]) == 2
    for path in demo["pictures"]:
        picture = cv2.imread(str(work / path))
        assert picture.shape == (800, 1600, 3)
        assert picture.std() > 10
    return Path(demo["map"])


def test_nothing_that_is_installed_points_into_the_checkout():
    told, inside = [], re.compile(r"\b(tools|tests|recordings)/")
    for path in sorted([*(ROOT / "hickory_stream").rglob("*.py"), *(ROOT / "players").rglob("*.py")]):
        text = path.read_text(encoding="utf-8")
        # Most files need not be parsed.
        nodes = list(ast.walk(ast.parse(text))) if inside.search(text) else []
        docstrings = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
        strings = (one for one in nodes if isinstance(one, ast.Constant) and isinstance(one.value, str))
        told += [
            f"{path.relative_to(ROOT)}:{one.lineno}: {one.value}" for one in strings
            if id(one) not in docstrings and inside.search(one.value)
        ]  # fmt: skip
    assert told == []


def test_every_machine_gets_one_open3d_and_kiss_icp():
    with (ROOT / "pyproject.toml").open("rb") as stream:
        project = tomllib.load(stream)["project"]
    x86 = {"sys_platform": "linux", "platform_machine": "x86_64"}
    needed = [Requirement(line) for line in project["dependencies"]]
    names = {one.name for one in needed if one.marker is None or one.marker.evaluate(x86)}
    assert {"embreex", "open3d-cpu", "kiss-icp"} <= names
    assert "open3d" not in names
    # Where embreex has no wheel, rays are cast by Open3D.
    arm = {"sys_platform": "linux", "platform_machine": "aarch64"}
    names = {one.name for one in needed if one.marker is None or one.marker.evaluate(arm)}
    assert {"open3d", "kiss-icp"} <= names
    assert not {"embreex", "open3d-cpu"} & names


def _clean_copy(folder):
    """Return a copy of what is needed to build: building in the checkout would leave files in it."""
    copy = folder / "source"
    copy.mkdir()
    for name in ("hickory_stream", "players"):
        shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, copy / name)
    return copy


def _link_what_it_needs(site):
    """Put links to what the installed package declares to need into its environment, and to nothing else of ours.

    An installation by pip would be the same, and take a minute.
    """
    [installed] = metadata.distributions(name="hickory-stream", path=[str(site)])
    waiting = _needed_by(installed, "")
    done = set()
    while waiting:
        needed = waiting.pop()
        distribution = metadata.distribution(needed.name)
        for extra in {"", *needed.extras} - {extra for name, extra in done if name == needed.name}:
            done.add((needed.name, extra))
            waiting += _needed_by(distribution, extra)
        for name in {file.parts[0] for file in distribution.files or ()} - {"..", "__pycache__"}:
            if not (site / name).exists():
                (site / name).symlink_to(Path(str(distribution.locate_file(name))))


def _needed_by(distribution, extra):
    needed = [Requirement(line) for line in distribution.requires or ()]
    return [one for one in needed if one.marker is None or one.marker.evaluate({"extra": extra})]


def _run(*command, cwd):
    words = [str(part) for part in command]
    done = subprocess.run(words, cwd=cwd, env=ENVIRONMENT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{command}: {done.stderr[-2000:]}"
    return done.stdout


MARKERS = "here==1\nthere==1 ; platform_machine == 'aarch64'\n"


@pytest.fixture
def asked(tmp_path):
    """The reason why a lock cannot be installed from two wheels: one for all machines, one for aarch64."""
    wheels = tmp_path / "wheels"
    wheels.mkdir()
    for name, tag in (("here", "py3-none-any"), ("there", "cp313-cp313-manylinux_2_28_aarch64")):
        with zipfile.ZipFile(wheels / f"{name}-1-{tag}.whl", "w") as wheel:
            wheel.writestr(f"{name}-1.dist-info/METADATA", f"Metadata-Version: 2.1\nName: {name}\nVersion: 1\n")

    def ask(machine, python, lock):
        path = tmp_path / "some.lock"
        path.write_text(lock)
        return obstacle(machine, python, path, "--no-index", "--find-links", str(wheels))

    return ask


def test_a_package_without_a_wheel_for_the_machine_is_named(asked):
    assert asked("x86_64", "3.13", MARKERS) == asked("aarch64", "3.13", MARKERS) == ""
    assert "there==1 has no" in asked("x86_64", "3.13", "here==1\nthere==1\n")
    assert "we only found wheels for `there`" in asked("aarch64", "3.12", MARKERS)


def pins(name):
    lines = (Path(__file__).resolve().parent.parent / name).read_text().splitlines()
    return dict(line.partition(" ")[0].split("==") for line in lines if "==" in line)


def test_the_lock_of_the_product_is_a_part_of_all(asked):
    product, every = pins("requirements.lock"), pins("requirements-test.lock")
    assert {"numpy", "rerun-sdk", "open3d-cpu", "open3d", "kiss-icp", "pip", "setuptools", "uv"} <= product.keys()
    assert not {"mypy", "ruff", "dask", "onnx", "mujoco", "scikit-learn", "huggingface-hub", "torch"} & product.keys()
    assert product.items() <= every.items()
