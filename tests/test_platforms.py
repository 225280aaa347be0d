import subprocess
from tools import platforms
from tools.platforms import Target, dependencies, without_wheel


def names(target: Target) -> set[str]:
    return {requirement.partition(">")[0].partition("<")[0] for requirement in dependencies(target)}


def test_markers_are_those_of_the_machine_that_is_asked_for():
    pc, jetson = names(Target("x86_64", "3.12")), names(Target("aarch64", "3.12"))
    assert "embreex" in pc
    assert "embreex" not in jetson
    assert "open3d-cpu" in pc
    assert "open3d" in jetson
    assert {"numpy", "eclipse-zenoh", "rerun-sdk"} <= pc & jetson


def test_what_only_developers_and_extras_need_is_not_asked_for():
    assert not {"mypy", "cyclonedds", "torch"} & names(Target("x86_64", "3.11"))


def test_what_has_no_wheel_is_found_among_the_others(monkeypatch):
    asked: list[list[str]] = []

    def pip(command: list[str], **_: object) -> subprocess.CompletedProcess[str]:
        asked.append(command)
        assert "--only-binary=:all:" in command
        assert command[command.index("--python-version") + 1] == "3.13"
        assert "manylinux_2_28_aarch64" in command
        return subprocess.CompletedProcess(command, int(bool({"c>=1", "f"} & set(command))), "", "")

    monkeypatch.setattr(platforms.subprocess, "run", pip)
    target = Target("aarch64", "3.13")
    assert without_wheel(["a", "b", "c>=1", "d", "e", "f"], target) == ["c>=1", "f"]
    asked.clear()
    assert without_wheel(["a", "b"], target) == []
    assert len(asked) == 1
