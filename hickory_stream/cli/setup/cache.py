"""`hickory-stream cache`: show or remove cached data."""

import argparse

from hickory_stream.base.caches import KINDS, cache_root, cap_mb, clear, entries
from hickory_stream.cli.commands import Commands
from hickory_stream.errors import InputError
from hickory_stream.outputs import output


def add(commands: Commands) -> None:
    actions = commands.group("cache", _show)
    actions.add("show", _show)
    cleared = actions.add("clear", _clear)
    cleared.add_argument("kinds", nargs="*", metavar="KIND", help=f"of {', '.join(KINDS)}; default: all")


def _show(options: argparse.Namespace) -> int:
    totals = {kind: [0, 0] for kind in KINDS}
    for entry in entries():
        totals[entry.kind][0] += 1
        totals[entry.kind][1] += entry.num_bytes
    if options.json:
        kinds = {kind: {"entries": number, "bytes": size} for kind, (number, size) in totals.items()}
        print(output("cache-show", {"folder": str(cache_root()), "cap_mb": cap_mb(), "kinds": kinds}))
        return 0
    print(cache_root())
    for kind, (number, size) in totals.items():
        print(f"  {kind:<12}{number:>7} entries {size / 1e6:>9.1f} MB")
    total_mb = sum(size for _, size in totals.values()) / 1e6
    print(f"  {'total':<12}{'':>15} {total_mb:>9.1f} MB of at most {cap_mb():g} (HICKORY_CACHE_MB)")
    return 0


def _clear(options: argparse.Namespace) -> int:
    unknown = [kind for kind in options.kinds if kind not in KINDS]
    if unknown:
        raise InputError(f"found kind {unknown[0]!r}, expected some of {', '.join(KINDS)}")
    kinds = [kind for kind in KINDS if kind in options.kinds or not options.kinds]
    num_bytes = clear(kinds)
    if options.json:
        print(output("cache-clear", {"folder": str(cache_root()), "cleared": kinds, "bytes": num_bytes}))
    else:
        print(f"removed {', '.join(kinds)} from {cache_root()}: {num_bytes / 1e6:.1f} MB")
    return 0
