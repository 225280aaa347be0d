from hickory_stream.cli import main
from tests.cli.test_cli import refusal


def test_a_demo_replaces_an_earlier_one_only_when_asked(tmp_path):
    folder = tmp_path / "demo"
    (folder / "map").mkdir(parents=True)
    (folder / "room.mcap").write_bytes(b"an earlier one")
    own = folder / "notes.txt"
    own.write_text("mine")
    assert "room.mcap exists; replace it with --overwrite" in refusal("demo", "--out", folder, "--seconds", "2")
    assert main(["demo", "--out", str(folder), "--overwrite", "--seconds", "0"]) == 2
    assert own.read_text() == "mine"
    assert not (folder / "map").exists()


def test_a_demo_that_cannot_be_written_says_where(tmp_path):
    (tmp_path / "file").write_text("")
    assert "cannot write into" in refusal("demo", "--out", tmp_path / "file" / "demo")
