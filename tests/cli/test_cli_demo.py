from hickory_stream.cli import main


def test_a_demo_replaces_an_earlier_one_only_when_asked(tmp_path, capsys):
    folder = tmp_path / "demo"
    (folder / "map").mkdir(parents=True)
    (folder / "room.mcap").write_bytes(b"an earlier one")
    own = folder / "notes.txt"
    own.write_text("mine")
    assert main(["demo", "--out", str(folder), "--seconds", "2"]) == 2
    assert "room.mcap exists; replace it with --overwrite" in capsys.readouterr().err
    assert main(["demo", "--out", str(folder), "--overwrite", "--seconds", "0"]) == 2
    assert own.read_text() == "mine"
    assert not (folder / "map").exists()


def test_a_demo_that_cannot_be_written_says_where(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert main(["demo", "--out", str(tmp_path / "file" / "demo")]) == 2
    assert "cannot write into" in capsys.readouterr().err
