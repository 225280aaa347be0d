import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
import pytest
import hickory_stream
from hickory_stream.cli import main
from hickory_stream.cli.commands import commands_of
from hickory_stream.cli.examples import TEXTS
from hickory_stream.cli.parser import make_parser
from tests.cli.test_cli import said
from tests.readmes import blocks_of
from tools.readmes import READMES

CLI_README = Path(hickory_stream.__file__).parent / "cli" / "README.md"
PLAN = ("plan", "m", "--start", "0,0", "--goal", "1,1")
COMMANDS = [" ".join(path) for path, _ in commands_of(make_parser()) if path]


def readme_commands():
    """Return the arguments of every line of the READMEs' shell blocks that is a whole command."""
    lines = "".join(blocks_of("sh", readme) for readme in READMES).replace("\\\n", " ").splitlines()
    starts = re.compile(r"^(?:\.venv/bin/)?hickory-stream ([^#]+)")
    found = [hit[1].strip() for line in lines if (hit := starts.match(line))]
    return [text.replace("[C ...]", "C").replace("LOG...", "LOG").replace("LOG ...", "LOG") for text in found]


def test_the_texts_are_of_the_commands_there_are():
    assert set(TEXTS) == set(COMMANDS)


@pytest.mark.parametrize("command", COMMANDS)
def test_the_help_of_a_command_has_an_example_that_parses(command, capsys):
    with pytest.raises(SystemExit):
        main([*command.split(), "--help"])
    shown = capsys.readouterr().out
    sentence, example = TEXTS[command]
    assert sentence.endswith(".")
    assert sentence in " ".join(shown.split())
    assert f"example:\n  hickory-stream {example}\n" in shown
    assert example.startswith(command)
    assert callable(make_parser().parse_args(shlex.split(example.split(" > ")[0])).run)


def test_the_lines_of_the_readmes_are_understood():
    lines = readme_commands()
    assert len(lines) > 45
    for line in lines:
        # Of alternatives, such as list|add|check|where, the first one.
        text = re.sub(r"\b(\w+)\|[\w|]+", r"\1", line)
        assert callable(make_parser().parse_args(shlex.split(text)).run), text


def test_the_plans_of_the_readmes_find_a_path_in_the_demo(demo_log, tmp_path):
    # The first ten seconds show both ends of every path; shapes only narrow what is in the way.
    quick = ("--frames", "60", "--set", "mapper.mapping.requests.max_failures=0", "--viewer", "none")
    said("play", demo_log, "--out", tmp_path / "map", *quick)
    plans = [shlex.split(line) for line in sorted(set(readme_commands())) if line.startswith("plan ")]
    assert len(plans) >= 2
    for arguments in plans:
        at = {"MAP": str(tmp_path / "map"), "plan.png": str(tmp_path / f"{len(list(tmp_path.iterdir()))}.png")}
        assert "verified along the whole length" in said(*(at.get(word, word) for word in arguments))


def test_names_in_the_readmes_are_exported_by_the_package():
    text = "".join(readme.read_text(encoding="utf-8") for readme in READMES)
    used = set(re.findall(r"`?\b(Mapper|MapperConfig|ClearanceScene|free_space_of|load_robot|plan|open_map)[.(]", text))
    assert {"Mapper", "ClearanceScene", "free_space_of", "open_map"} <= used
    assert used <= set(hickory_stream.__all__)
    for name in hickory_stream.__all__:
        assert getattr(hickory_stream, name) is not None
        assert name in dir(hickory_stream)
    with pytest.raises(AttributeError, match="no attribute 'Maper'"):
        _ = hickory_stream.Maper


def test_the_package_is_imported_without_what_it_may_need_later():
    script = "import sys, hickory_stream; print([n for n in ('numpy', 'scipy', 'numba', 'rerun') if n in sys.modules])"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def completed(script, words, folder):
    """Return what bash offers for the last of some words."""
    listed = " ".join(map(shlex.quote, words))
    asked = f"COMP_WORDS=({listed}); COMP_CWORD={len(words) - 1}; _shtab_hickory_stream; "
    asked += "printf '%s\\n' \"${COMPREPLY[@]}\""
    done = subprocess.run(
        ["bash", "--norc", "-c", f"{script}\n{asked}"], capture_output=True, text=True, check=True, cwd=folder
    )
    return set(done.stdout.split())


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
def test_bash_completes_commands_options_values_and_files(tmp_path):
    script = said("completion", "bash")
    (tmp_path / "demo.map").mkdir()
    (tmp_path / "other.mcap").touch()
    for words, offered in (
        (["re"], {"resume", "replay", "render", "relocalise", "reconstruct"}),
        (["eval"], {"evaluate"}),
        (["models", ""], {"list", "add", "check", "get", "where"}),
        (["generators", ""], {"list", "check"}),
        (["config", "d"], {"dump"}),
        (["plan", "demo.map", "--pl"], {"--planner"}),
        (["plan", "demo.map", "--planner", ""], {"rrt", "rrt-connect", "rrt-star"}),
        (["export", "demo.map", "--format", "m"], {"mjcf"}),
        (["models", "add", "--kind", "d"], {"dinov2"}),
        (["completion", ""], {"bash", "zsh", "fish"}),
        (["play", "oth"], {"other.mcap"}),
        (["render", "demo.map", "-o", "o"], {"other.mcap"}),
    ):
        assert completed(script, ["hickory-stream", *words], tmp_path) == offered, words
    everything = completed(script, ["hickory-stream", ""], tmp_path)
    assert {path for path in COMMANDS if " " not in path} <= everything


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_scripts_of_other_shells_name_every_command(shell, tmp_path):
    script = said("completion", shell)
    for command in COMMANDS:
        assert re.search(rf"\b{re.escape(command.split()[-1])}\b", script)
    if shutil.which(shell) is not None:
        (tmp_path / "script").write_text(script)
        subprocess.run([shell, "-n", tmp_path / "script"], check=True)


def test_the_help_lists_each_command_in_its_group(capsys):
    with pytest.raises(SystemExit, match="0"):
        main(["--help"])
    listed = capsys.readouterr().out.partition("commands:\n")[2]
    groups = re.findall(r"^  (\w.*):\n((?:    .*\n)+)", listed, re.MULTILINE)
    assert [name.split()[0] for name, _ in groups] == ["make", "look", "use", "compare", "measure", "maintain"]
    names = [name for _, lines in groups for name in re.findall(r"^    (\w+) ", lines, re.MULTILINE)]
    assert sorted(names) == sorted(name for name in COMMANDS if " " not in name)
    assert all(re.search(rf"^# {name}$", blocks_of("sh", CLI_README), re.MULTILINE) for name, _ in groups)


@pytest.mark.parametrize(("words", "answer"), [
    (["inspct", "m"], "found inspct, did you mean inspect?"),
    (["xyzzy"], "found xyzzy, expected one of demo, play,"),
    (["generators", "lst"], "found lst, did you mean list?"),
    (["export", "m", "--format", "gbl"], "found gbl, did you mean glb?"),
    (["inspect", "m", "--min-sise", "1"], "found --min-sise, did you mean --min-size?"),
    (["inspect", "m", "n"], "found n, which is not expected; see hickory-stream inspect --help"),
    (["evaluate-views", "a.mcap"], "which is now `paper --table views` in the folder tools"),
    ([*PLAN, "--unproven"], "found --unproven, which is now --allow-unverified"),
    (["resume", "m", "--own-workers"], "which is now --use-current-workers"),
])  # fmt: skip
def test_a_misspelt_or_former_word_is_answered_by_todays(words, answer, capsys):
    with pytest.raises(SystemExit, match="2"):
        main(words)
    assert answer in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize(("alone", "action"), [("generators", "list"), ("models", "list"), ("cache", "show")])
def test_a_group_alone_does_its_first_action(alone, action, tmp_path, monkeypatch):
    monkeypatch.setenv("HICKORY_CACHE", str(tmp_path))
    assert said(alone) == said(alone, action) != ""
