import zipfile
from pathlib import Path
import pytest
from tools.platforms import obstacle

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


def test_markers_are_those_of_the_machine_that_is_asked_for(asked):
    assert asked("x86_64", "3.13", MARKERS) == ""
    assert asked("aarch64", "3.13", MARKERS) == ""


def test_a_package_without_a_wheel_for_the_machine_is_named(asked):
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
