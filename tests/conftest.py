"""Shared settings: hypothesis without deadlines (the first call of a numba kernel compiles it), places of real data."""

import asyncio
import fcntl
import gc
import inspect
import json
import os
import sys
from pathlib import Path
import pytest
from hypothesis import settings

# The processes that tests start load compiled modules: to compile ours takes each of them a second.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
# Each process of the tests has a processor of its own: more threads would only wait for one another.
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

settings.register_profile("default", deadline=None, max_examples=50, derandomize=True)
settings.load_profile("default")

ROOT = Path(__file__).resolve().parent.parent


def pytest_sessionstart(session):
    """Compile what has changed before the tests of the whole project, so that no test's time goes to the compiler."""
    if session.config.args == session.config.getini("testpaths"):
        from hickory_stream.engine.first_run import compile_kernels  # not for the single test that needs no kernel

        asyncio.run(compile_kernels(lambda done, total: None))


def pytest_collection_finish():
    """Take what was collected out of the garbage collector, which else goes through all of it again and again."""
    gc.collect()
    gc.freeze()


def pytest_pyfunc_call(pyfuncitem):
    """Run a test that is a coroutine in a loop of its own."""
    if not inspect.iscoroutinefunction(pyfuncitem.obj):
        return None
    asyncio.run(pyfuncitem.obj(**{name: pyfuncitem.funcargs[name] for name in pyfuncitem._fixtureinfo.argnames}))
    return True


COARSE_SHAPES = """\
[mapper.run]
shape_cache = false
[mapper.shapes.fused.volume]
cells = 16
[mapper.shapes.fit]
cells = 16
num_seeds = 1
num_candidates = 1
max_primitives = 1
coarse_samples = 100
coarse_iterations = 3
fine_samples = 300
fine_iterations = 4
gain_samples = 1000
joint_samples = 500
"""


def pytest_collection_modifyitems(items):
    """Begin with what takes minutes, so that no processor waits for it at the end."""
    items.sort(key=lambda item: item.get_closest_marker("slow") is None)


@pytest.fixture(autouse=True)
def _outputs_keep_to_their_form(monkeypatch):
    """Hold whatever a command prints with `--json`, in any test, against its schema."""
    from hickory_stream import outputs
    from tests.output_forms import checked

    write = outputs.dumps

    def dumps(data, *, indent=None):
        text = write(data, indent=indent)
        checked(json.loads(text))
        return text

    monkeypatch.setattr(outputs, "dumps", dumps)


@pytest.fixture(scope="session")
def demo_log():
    return ROOT / "recordings" / "demo.mcap"


@pytest.fixture(scope="session")
def demo_truth():
    return ROOT / "recordings" / "demo.truth"


def shared_data(name, content):
    folder = ROOT.parent / "shared" / "data" / name
    if not folder.is_dir():
        pytest.skip(f"needs the {content} in {name} beside the checkout")
    return folder


@pytest.fixture(scope="session")
def redkitchen():
    return shared_data("redkitchen", "7-Scenes frames")


@pytest.fixture(scope="session")
def mosd():
    return shared_data("mosd", "labelled clouds")


def made_once(factory, name, make):
    """Return the path that the first process of this test run made; the other processes wait for it."""
    root = factory.getbasetemp()
    root = root.parent if "PYTEST_XDIST_WORKER" in os.environ else root
    with (root / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        done = root / f"{name}.done"
        if not done.exists():
            make(root / name)
            done.touch()
    return root / name


@pytest.fixture(scope="session")
def short_log(demo_log, tmp_path_factory):
    """The first three seconds of the demo: 18 frames."""
    return made_once(tmp_path_factory, "short.mcap", lambda path: copy_log(demo_log, path, seconds=3.0))


@pytest.fixture(scope="session")
def coarse_config(tmp_path_factory):
    """A configuration file with which a shape takes a tenth of a second instead of one."""
    path = tmp_path_factory.mktemp("config") / "coarse.toml"
    path.write_text(COARSE_SHAPES)
    return path


@pytest.fixture(scope="session")
def short_map(short_log, coarse_config, tmp_path_factory):
    """The map of the first three seconds of the demo, as the command line makes it; not to be changed.

    What `play` printed lies beside it.
    """
    from tests.cli.test_cli import EAGER, look

    def make(out):
        ended = look("play", short_log, "--config", coarse_config, "--viewer", "none", "--out", out, *EAGER)
        assert ended.status == 0, ended.stderr
        out.with_suffix(".said").write_text(ended.stdout)

    return made_once(tmp_path_factory, "short.map", make)


@pytest.fixture(scope="session")
def undisturbed_run(tmp_path_factory):
    """The run of the scene by one worker, which nobody disturbs; its folder is not to be changed."""
    from tests.engine.run_fixtures import map_scene

    return map_scene(tmp_path_factory.mktemp("undisturbed"), child_workers=True)


def copy_log(source, target, *, seconds, topic_of=str, data_of=bytes):
    """Write the beginning of an MCAP file to another one, with other topics and content if asked for."""
    from mcap.reader import make_reader
    from mcap.writer import Writer

    with source.open("rb") as read, target.open("wb") as written:
        reader, writer = make_reader(read), Writer(written)
        end_ns = reader.get_summary().statistics.message_start_time + int(seconds * 1e9)
        writer.start(profile="ros2")
        channels = {}
        for schema, channel, message in reader.iter_messages(ending_before=end_ns):
            if channel.id not in channels:
                schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                topic = topic_of(channel.topic)
                channels[channel.id] = writer.register_channel(topic, channel.message_encoding, schema_id)
            data = data_of(message.data)
            writer.add_message(channels[channel.id], message.log_time, data, message.publish_time)
        writer.finish()
    return target
