"""`hickory-stream query`: objects of a map that answer a question, or their number."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hickory_stream.cli.commands import NO_ANSWER, Commands
from hickory_stream.cli.option_values import add_at, open_map_at, parse_place, positive
from hickory_stream.cli.output_files import add_output, check_ending, write_picture
from hickory_stream.errors import InputError
from hickory_stream.outputs import output

if TYPE_CHECKING:
    import argparse

    from hickory_stream.map_folder.saved_map import SavedMap
    from hickory_stream.query.answers import Answer, Answers
    from hickory_stream.query.looks import ObjectLooks
    from hickory_stream.query.map_index import MapIndex

_TOLD_EVERY = 100


def add(commands: Commands) -> None:
    query = commands.add("query", run)
    query.add_argument("map", type=Path, metavar="MAP")
    query.add_argument("question", nargs="+", metavar="WORD", help='e.g. "a red box on a table" or "how many chairs"')
    query.add_argument("--top", type=int, default=5, metavar="N", help="show the best N answers, default 5")
    query.add_argument(
        "--from",
        dest="viewer",
        metavar="X,Y",
        help='viewpoint of "in front of", "left of" and so on; default: the best viewpoint of the landmark',
    )
    query.add_argument(
        "--model", metavar="NAME", help="image-text network for words beyond geometry; default: the only one"
    )
    add_output(query, "-o", "--out", type=Path, metavar="PNG", help="draw the map with the answers, and their views")
    add_at(query)


def run(options: argparse.Namespace) -> int:
    from hickory_stream.config import as_far_as_known
    from hickory_stream.query.answers import ask
    from hickory_stream.query.grammar import UnknownWord, stands_in
    from hickory_stream.query.map_index import index_of

    top = positive(options.top, "--top")
    check_ending(options.out, ".png")
    viewer = None if options.viewer is None else parse_place(options.viewer, "--from")
    saved = open_map_at(options.map, options.at)
    index = index_of(saved.snapshot, as_far_as_known(saved.manifest.config).mapping)
    question = " ".join(options.question)
    network, why_none = _network_name(options.model)
    looks = None
    if network is not None and stands_in(question):
        looks = _looks(saved, index, network, is_quiet=options.json)
    try:
        answers = ask(index, question, viewer, looks)
    except UnknownWord as unknown:
        if network is None:
            raise InputError(f"{unknown}; {why_none}") from unknown
        answers = ask(index, question, viewer, _looks(saved, index, network, is_quiet=options.json))
    if options.out is not None:
        from hickory_stream.query.picture import draw_answers

        write_picture(options.out, draw_answers(saved, answers))
    print(output("query", _as_json(index, answers, top), indent=1) if options.json else _as_text(index, answers, top))
    return 0 if answers.found or answers.counts else NO_ANSWER


def _network_name(model: str | None) -> tuple[str | None, str]:
    # The image-text network to use, or why there is none.
    from hickory_stream.perception.models.library import models_folder, read_manifest

    there = [entry.name for entry in read_manifest(models_folder()).values() if entry.kind == "image-text"]
    if model is not None or len(there) == 1:
        return model or there[0], ""
    if there:
        return None, f"there are several image-text networks ({', '.join(there)}): choose one with --model"
    return None, "an image-text network may know it (`hickory-stream models add FOLDER --kind image-text`)"


def _looks(saved: SavedMap, index: MapIndex, name: str, *, is_quiet: bool) -> ObjectLooks:
    from hickory_stream.perception.models.image_text import open_image_text
    from hickory_stream.perception.models.library import find_model
    from hickory_stream.perception.models.network import Network, NetworkConfig
    from hickory_stream.query.looks import ObjectLooks

    entry, path = find_model(name, "image-text")
    config = NetworkConfig(warm_up=False)
    network = open_image_text(entry, Network(path, config), config)
    preprocessor = next(one.sha256 for one in entry.companions if one.role == "preprocessor")

    def progress(done: int, total: int) -> None:
        if done == total or done % _TOLD_EVERY == 0:
            print(f"views processed by {entry.name}: {done} of {total}", file=sys.stderr)

    text = {} if is_quiet else {"progress": progress}
    return ObjectLooks(saved, index, network, entry.sha256 + preprocessor, **text)


def _as_json(index: MapIndex, answers: Answers, top: int) -> dict[str, Any]:
    return {
        "question": answers.question,
        "counts": answers.counts,
        "by": answers.judged_by,
        "count": len(answers.found),
        "answers": [_answer_json(index, answer) for answer in answers.found[:top]],
        "nearly": [_answer_json(index, answer) for answer in answers.nearly],
    }


def _answer_json(index: MapIndex, answer: Answer) -> dict[str, Any]:
    from hickory_stream.records import ObjectKind

    i = index.ids.tolist().index(answer.id)
    return {
        "object": answer.id,
        "kind": ObjectKind.of(index.fixed[i]),
        "fixture_probability": round(float(index.fixed[i]), 4),
        "goal": f"object:{answer.id}",
        "score": answer.score,
        "center_m": [round(part, 4) for part in index.centers[i].tolist()],
        "size_m": [round(part, 4) for part in index.sides_m[i].tolist()],
        "why": dict(answer.why),
    }


def _as_text(index: MapIndex, answers: Answers, top: int) -> str:
    asked = f"{answers.question}: "
    if answers.counts:
        return f"{asked}{len(answers.found)}{_listed(answers)}, by {answers.judged_by}"
    if not answers.found:
        near = [f"  nearly: {_line(index, answer)}" for answer in answers.nearly]
        return "\n".join([f"{asked}nothing in the map answers, by {answers.judged_by}", *near])
    lines = [_line(index, answer) for answer in answers.found[:top]]
    more = len(answers.found) - top
    lines += [f"and {more} more"] if more > 0 else []
    return "\n".join([f"{asked}{len(answers.found)} found, by {answers.judged_by}", *lines])


def _listed(answers: Answers) -> str:
    return f" ({', '.join(f'#{answer.id}' for answer in answers.found)})" if answers.found else ""


def _line(index: MapIndex, answer: Answer) -> str:
    from hickory_stream.records import kind_text

    i = index.ids.tolist().index(answer.id)
    x, y, z = index.centers[i]
    why = ", ".join(f"{text} {score:.2f}" for text, score in answer.why)
    return f"#{answer.id:<5} {answer.score:.2f}  {kind_text(index.fixed[i])} at ({x:.2f}, {y:.2f}, {z:.2f}) m: {why}"
