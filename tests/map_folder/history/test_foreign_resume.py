import json
import os
import shutil
import socket
from dataclasses import asdict, replace
import pytest
from hickory_stream.config import MapperConfig, RunConfig
from hickory_stream.engine.mapper import Mapper
from hickory_stream.errors import ConfigError
from hickory_stream.journal.writer import JournalWriter
from hickory_stream.map_folder.history.recorded_config import resumed_config
from hickory_stream.map_folder.writer import create_map_folder
from players import SourceOptions, make_source_note, open_source
from tests.cli.test_cli import refusal


@pytest.fixture
def interrupted(tmp_path, demo_log):
    """Makes the map of a playback that was killed at once, made with some configuration of its run."""

    def make(note=None, **run):
        path = tmp_path / "map"
        source = open_source(demo_log)
        config = replace(MapperConfig(), run=RunConfig(**run))
        note = note or make_source_note([demo_log], SourceOptions(), first_frames=1)
        asked = {"mode": "playback", "loops": 1, "source": note}
        folder = create_map_folder(path, config=asdict(config), source=asdict(source.info), run=asked)
        source.close()
        JournalWriter(path, flush_s=1.0).abandon()
        folder.close()
        return path

    return make


@pytest.fixture
def program(tmp_path):
    """A program that leaves a mark where it is run."""
    path = tmp_path / "python"
    path.write_text(f"#!/bin/sh\ntouch {tmp_path / 'WAS-RUN'}\n")
    path.chmod(0o755)
    return path


def test_an_interpreter_that_a_map_names_is_not_run_unasked(interrupted, program, tmp_path):
    path = interrupted(worker_python=str(program))
    (told,) = refusal("resume", path).splitlines()
    for part in (str(program), "run.worker_python", "--set mapper.run.worker_python=", "--use-current-workers"):
        assert part in told
    with pytest.raises(ConfigError, match="never run"):
        Mapper.resuming(path)
    assert Mapper.resuming(path, ignores_recorded_workers=True).config.run.worker_python == ""
    assert not (tmp_path / "WAS-RUN").exists()


def test_a_cluster_that_a_map_names_is_not_connected_to(interrupted):
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(0.2)
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        assert address in refusal("resume", interrupted(cluster=address))
        with pytest.raises(TimeoutError):
            server.accept()


def test_names_of_this_machine_win_over_those_of_the_map(interrupted, program):
    path = interrupted(worker_python=str(program), crop_margin=0.2)
    config = resumed_config(path, RunConfig(worker_python=str(program), crop_margin=0.5))
    assert config.run.worker_python == str(program)
    assert config.run.crop_margin == 0.2
    assert resumed_config(path, RunConfig(), ignores_recorded=True).run.worker_python == ""
    shutil.rmtree(path)
    assert resumed_config(interrupted(), RunConfig(cluster="tcp://gpu:8786")).run.cluster == "tcp://gpu:8786"


@pytest.mark.timeout(30)
@pytest.mark.parametrize("uri", ["pipe.mcap", "/dev/zero", "//server/share/log.mcap", 7, ""])
def test_a_log_that_is_neither_file_nor_folder_is_not_opened(interrupted, tmp_path, uri):
    os.mkfifo(tmp_path / "pipe.mcap")
    uri = str(tmp_path / uri) if uri == "pipe.mcap" else uri
    path = interrupted(note={**make_source_note([], SourceOptions()), "uris": [uri]})
    assert len(refusal("resume", path).splitlines()) == 1


def test_a_damaged_note_is_refused_in_one_line(interrupted, demo_log):
    note = make_source_note([demo_log], SourceOptions())
    path = interrupted()
    for change in (
        {"options": []},
        {"first_frames": "all"},
        {"options": {"clock": 7}},
        {"start_s": []},
        {"uris": 3},
        {"faults": "drop=0.1"},
        {"faults": 7},
    ):
        manifest = json.loads((path / "manifest.json").read_text())
        manifest["run"]["source"] = {**note, **change}
        (path / "manifest.json").write_text(json.dumps(manifest))
        assert len(refusal("resume", path).splitlines()) == 1, change
