"""The picture of the packages is that of the code."""

from __future__ import annotations

from graphlib import CycleError

import pytest

from tools.package_picture import PICTURE, import_graph, picture


def test_the_picture_in_the_readme_is_that_of_the_code() -> None:
    assert PICTURE.read_text(encoding="utf-8") == picture(import_graph()), "run tools/draw_packages"


def test_a_box_stands_above_what_it_imports_and_lines_that_follow_from_others_are_left_out() -> None:
    drawn = picture({"cli": {"engine", "errors"}, "engine": {"errors"}, "errors": set()})
    heights = {
        name: float(drawn.split(f">{name}<")[0].rpartition(' y="')[2].split('"')[0]) for name in ("cli", "errors")
    }
    assert heights["cli"] < heights["errors"]
    assert drawn.count("<path") == 2


def test_imports_that_go_round_in_a_circle_are_no_picture() -> None:
    with pytest.raises(CycleError):
        picture({"engine": {"cli"}, "cli": {"engine"}})
