"""The account of all messages of a log, each in one bucket: that of the source, completed by the run's use of frames.

The source counts the images of all frames as used. The run did not need those of frames that were no keyframes, and
some of its keyframes may have been unreadable.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hickory_stream.ports import account_of

if TYPE_CHECKING:
    from collections.abc import Mapping

    from hickory_stream.ports import Source

_IMAGES_PER_FRAME = 2


def message_ledger(source: Source, frames: Mapping[str, int]) -> dict[str, Any]:
    """Return the account of a source's messages, {} where it keeps none.

    `frames` are the run's counts: `read`, `keyframes`, `keyframes_kept_out`, `frames_undecodable`. After several rounds
    of a log the account is that of the last round, in which the images are not told apart.
    """
    kept = account_of(source)
    if kept is None:
        return {}
    account = kept.as_dict()
    counts = source.ledger()
    found, dropped, doubled = (counts.get(name, 0) for name in ("frames", "injected_drop", "injected_duplicate"))
    if frames.get("read", 0) != found - dropped + doubled:
        return account
    torn = frames.get("frames_undecodable", 0)
    # What was kept out of the map was looked at.
    needed = frames.get("keyframes", 0) + frames.get("keyframes_kept_out", 0)
    skipped = _IMAGES_PER_FRAME * max(0, found - needed - torn)
    account["not_keyframe"] = skipped
    account["not_needed"] += skipped
    account["unreadable"] += _IMAGES_PER_FRAME * torn
    account["used"] -= skipped + _IMAGES_PER_FRAME * torn
    return account
