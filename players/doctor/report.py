"""A diagnosis as text, and as a page with plots."""

import html
from collections.abc import Sequence
from typing import Any

from hickory_stream.base.html_page import page
from players.doctor.diagnosis import Diagnosis

_VERDICTS = {0: "SOUND", 2: "UNUSABLE", 3: "USABLE WITH LOSSES"}
_MAX_LINES = 12


def diagnosis_text(found: Diagnosis) -> str:
    """Return the diagnosis as lines of text."""
    lines = [f"{found.uri}: {_VERDICTS[found.status]}"]
    if found.kind:
        lines.append(f"{found.kind}, {found.num_bytes / 1e6:.1f} MB; checksums: {found.checksum or 'none'}")
    if found.refusal:
        lines += ["", f"cannot be mapped: {found.refusal}"]
    if found.live:
        lines += ["", *found.live["table"]]
    if found.topics:
        lines += ["", "topics"]
        width = max(len(name) for name in found.topics)
        for name, figures in found.topics.items():
            lines.append(f"  {name.ljust(width)}  {_topic_line(figures)}")
    if found.streams:
        lines += ["", "what would be played"]
        lines += [f"  {role}: {stream}" for role, stream in found.streams.items()]
    for role, image in found.images.items():
        size = "x".join(str(side) for side in image["size"]) if image["size"] else "unknown size"
        lines.append(f"  {role} images: {image['encoding'] or 'unreadable'}, {size}, frame {image['frame'] or 'none'}")
    if found.tf.get("edges") or found.tf.get("pose_streams"):
        lines += ["", "frames"]
        for e in found.tf["edges"]:
            lines.append(f"  {e['child']} in {e['parent']} ({'static' if e['static'] else 'moving'})")
        for s in found.tf["pose_streams"]:
            lines.append(f"  {s['topic']} gives {s['child'] or '(no child frame)'} in {s['parent']}")
    if found.sync:
        lines += ["", f"colour and depth: {found.sync['within']:.1%} within {found.sync['tolerance_ms']:.1f} ms, "]
        lines[-1] += f"median {found.sync['median_ms']} ms, 95 % within {found.sync['p95_ms']} ms"
        lines += _histogram_lines(found.sync["histogram"])
    if found.frames:
        lines += ["", _frames_line(found.frames), _depth_line(found.frames), _motion_line(found.frames["motion"])]
        lines.append(
            f"mapping should take about {found.estimate['map_s']:.0f} s and {found.estimate['memory_mb']:.0f} MB "
            "(two cores, no GPU)"
        )
    if found.ledger and "topics" in found.ledger:
        lines += ["", ledger_line(found.ledger)]
    for title, entries in (
        ("problems", found.problems),
        ("damage", [f"{d['file']} at byte {d['offset']}: {d['what']} ({d['bytes']} bytes)" for d in found.damage]),
        ("notes", found.notes),
    ):
        if entries:
            lines += ["", title, *(f"  {entry}" for entry in entries[:_MAX_LINES])]
            if len(entries) > _MAX_LINES:
                lines.append(f"  and {len(entries) - _MAX_LINES} more; --json lists all")
    return "\n".join(lines)


def ledger_line(account: dict[str, Any]) -> str:
    """Return the totals of an account in one line."""
    rejected = sum(account["rejected"].values())
    parts = [
        f"{account['declared']} {account['unit']} declared" if account["declared"] is not None else account["unit"],
        f"{account['used']} used",
        f"{account['not_needed']} not needed",
        f"{rejected} rejected" + (f" ({_counts(account['rejected'])})" if rejected else ""),
        f"{account['unreadable']} unreadable",
    ]
    if account["not_played"]:
        parts.append(f"{account['not_played']} not played")
    if account["difference"] or account["explanation"]:
        parts.append(account["explanation"] or f"{account['difference']} without explanation")
    return "ledger: " + ", ".join(parts)


def ledger_table(account: dict[str, Any]) -> str:
    """Return an account as a table with one line per bucket."""
    frames, damaged = account.get("not_keyframe"), f"{account['damaged_places']} damaged places"
    rows = [
        ("declared", account["declared"] if account["declared"] is not None else "unknown", ""),
        ("used", account["used"], ""),
        ("not needed", account["not_needed"], f"{frames} in frames that are no keyframes" if frames else ""),
        ("rejected", sum(account["rejected"].values()), _counts(account["rejected"])),
        ("unreadable", account["unreadable"], damaged * bool(account["unreadable"])),
        ("not played", account["not_played"], ""),
        ("difference", account["difference"], account["explanation"]),
    ]
    shown = [row for row in rows if row[1] or row[0] in ("declared", "used", "unreadable") or row[2]]
    return "\n".join(f"  {name:<10} {number!s:>9}  {detail}".rstrip() for name, number, detail in shown)


def damage_line(ledger: dict[str, Any]) -> str:
    """Return the damage of a run's log in one line, its other faults in one each; "" for a sound or no log."""
    account = ledger.get("messages") or {}
    number, lines = account.get("damaged_places"), list(account.get("findings", ()))
    if number:
        places = "1 damaged place" if number == 1 else f"{number} damaged places"
        first = account["damage"][0]
        lines.insert(0, f"the log has {places}, and what lies outside was played; the first: {first} (see `doctor`)")
    return "\n".join(lines)


def _counts(counts: dict[str, int]) -> str:
    return ", ".join(f"{number} {name.replace('_', ' ')}" for name, number in counts.items())


def _topic_line(figures: dict[str, Any]) -> str:
    rate = f"{figures['rate_hz']} Hz" if figures.get("rate_hz") else ""
    labels = {"gaps": "gaps", "out_of_order": "out of order", "duplicates": "doubled", "unset_stamps": "without stamp"}
    odd = [f"{figures[key]} {label}" for key, label in labels.items() if figures.get(key)]
    offset = figures.get("log_offset_s")
    if offset is not None and abs(offset) > 0.5:
        odd.append(f"recorded {offset} s off")
    detail = f" ({'; '.join(odd)})" if odd else ""
    return f"{figures['type'] or 'no type'}  {figures['messages']} {rate}{detail}"


def _frames_line(frames: dict[str, Any]) -> str:
    size = "x".join(str(side) for side in frames["size"])
    invalid = frames["depth_invalid_median"]
    depth = "" if invalid is None else f", {invalid:.0%} of the depth without return"
    torn = f", {frames['torn']} of {frames['sampled']} sampled frames torn" if frames["torn"] else ""
    rest = f", {frames['keyframes_at_rest']} of a camera at rest" if frames["keyframes_at_rest"] else ""
    keyframes = f"{frames['keyframes']} keyframes ({frames['keyframes_due']:.0f} due at this motion{rest})"
    return f"{frames['frames']} frames of {size}, {keyframes}{depth}{torn}, {_color_text(frames['color_on_depth'])}"


def _depth_line(frames: dict[str, Any]) -> str:
    noise, bias, sensor = frames["depth_noise"], frames["depth_bias"], frames["sensor"]
    believed = f"{sensor['noise_per_m']:.4f} z2" + (f" + {1e3 * sensor['noise_m']:.1f} mm" * (sensor["noise_m"] > 0))
    line = f"depth: too few flat patches for its noise, taken for {believed}"
    if noise is not None:
        constant = f" + {1e3 * noise['noise_m']:.1f} mm" * (noise["noise_m"] >= 5e-5)
        line = (
            f"depth: noise {noise['noise_per_m']:.4f} z2{constant} on {noise['num_patches']} flat patches from "
            f"{noise['near_m']:.1f} to {noise['far_m']:.1f} m (+- {3 * noise['error']:.0%}), taken for {believed}"
        )
    if bias is None:
        return f"{line}; too few views of the same surfaces for a bias"
    return f"{line}; bias {1e3 * bias['bias_m']:+.0f} +- {3e3 * bias['error_m']:.0f} mm"


def _motion_line(motion: dict[str, Any] | None) -> str:
    if motion is None:
        return "poses and images: too little moves to compare them"
    line = f"poses and images: agree on {motion['share']:.0%} of {motion['num_moving']} motions"
    if motion["scale"] is not None:
        line += f"; scale of depth {motion['scale']:.3g} +- {motion['scale'] * motion['scale_error']:.2g}"
    if motion["lag_s"] is not None:
        line += f"; poses late by {1e3 * motion['lag_s']:+.0f} +- {1e3 * motion['lag_error_s']:.0f} ms"
    return line


def _color_text(agreement: dict[str, Any] | None) -> str:
    if agreement is None:
        return "no evidence whether colour lies on depth"
    if agreement["is_off"]:
        return f"colour does not lie on depth ({agreement['offset_px']:.1f} pixels off)"
    return "colour lies on depth"


def _histogram_lines(histogram: dict[str, list[float]]) -> list[str]:
    counts, edges = histogram["counts"], histogram["edges_ms"]
    used = [i for i, count in enumerate(counts) if count]
    most = max(counts, default=0)
    return [
        f"  {edges[i]:8.1f} .. {edges[i + 1]:6.1f} ms  {'#' * max(1, round(30 * counts[i] / most))} {int(counts[i])}"
        for i in used[:_MAX_LINES]
    ]


_STYLE = """
table { width: 100%; font-size: .88rem; }
td, th { padding: .25rem .6rem; text-align: left; border-bottom: 1px solid var(--line); }
td.n, th.n { text-align: right; }
.verdict { display: inline-block; padding: .15rem .6rem; border-radius: .4rem; color: white; font-weight: 600; }
.s0 { background: #2c7a4b; } .s2 { background: #b3372f; } .s3 { background: #b7791f; }
svg text { font: 11px system-ui, sans-serif; fill: var(--soft); }
"""


def diagnosis_page(found: Diagnosis) -> str:
    """Return the diagnosis as a self-contained HTML page."""
    e = html.escape
    parts = [
        f"<h1>{e(found.uri)}</h1>",
        f"<p><span class='verdict s{found.status}'>{_VERDICTS[found.status].lower()}</span> {e(found.kind)}, "
        f"{found.num_bytes / 1e6:.1f} MB; checksums: {e(found.checksum or 'none')}</p>",
    ]
    if found.refusal:
        parts.append(f"<p><b>Cannot be mapped:</b> {e(found.refusal)}</p>")
    for title, entries in (("Problems", found.problems), ("Notes", found.notes)):
        if entries:
            parts.append(f"<h2>{title}</h2><ul>" + "".join(f"<li>{e(entry)}</li>" for entry in entries) + "</ul>")
    if found.streams:
        rows = "".join(f"<tr><td>{e(r)}</td><td><code>{e(s)}</code></td></tr>" for r, s in found.streams.items())
        parts.append(f"<h2>What would be played</h2><table>{rows}</table>")
    if found.frames:
        parts.append(
            f"<p>{e(_frames_line(found.frames))}; {e(_depth_line(found.frames))}. "
            f"Mapping should take about {found.estimate['map_s']:.0f} s.</p>"
        )
    if found.ledger and "topics" in found.ledger:
        parts.append(f"<p>{e(ledger_line(found.ledger))}.</p>")
    if found.topics:
        parts += ["<h2>Topics in time</h2>", _timeline(found.topics), _topic_table(found.topics)]
    if found.sync:
        counts = found.sync["histogram"]["counts"]
        edges = [f"{edge:.1f} ms" for edge in found.sync["histogram"]["edges_ms"]]
        titles = [f"{a} to {b}: {n}" for a, b, n in zip(edges, edges[1:], counts, strict=False)]
        plot = _bars(counts, titles, (edges[0], edges[-1]))
        parts += ["<h2>Nearest depth of each colour image</h2>", plot]
    if shares := found.frames.get("depth_invalid"):
        plot = _bars(shares, [f"{share:.0%}" for share in shares], ("first frame", f"last; most: {max(shares):.0%}"))
        parts += ["<h2>Depth without return, sampled frames</h2>", plot]
    if found.damage:
        names = ("file", "at byte", "what", "bytes", "messages")
        places = [[f"<td>{e(str(value))}</td>" for value in place.values()] for place in found.damage]
        table = "".join(f"<tr>{''.join(row)}</tr>" for row in ([f"<th>{name}</th>" for name in names], *places))
        parts.append(f"<h2>Damage</h2><table>{table}</table>")
    return page(found.uri, "\n".join(parts), _STYLE)


def _topic_table(topics: dict[str, dict[str, Any]]) -> str:
    keys = ("messages", "rate_hz", "jitter_ms", "gaps", "longest_gap_s", "out_of_order", "duplicates", "log_offset_s")
    head = "".join(f"<th class=n>{key.replace('_', ' ')}</th>" for key in keys)
    rows = "".join(
        f"<tr><td><code>{html.escape(name)}</code></td><td>{html.escape(f['type'] or 'no type')}</td>"
        + "".join(f"<td class=n>{'' if f.get(key) is None else f[key]}</td>" for key in keys)
        + "</tr>"
        for name, f in topics.items()
    )
    return f"<table><tr><th>topic</th><th>type</th>{head}</tr>{rows}</table>"


def _timeline(topics: dict[str, dict[str, Any]]) -> str:
    spans = {name: (f["first_s"], f["last_s"]) for name, f in topics.items() if f.get("first_s")}
    if not spans:
        return ""
    middles = sorted((a + b) / 2 for a, b in spans.values())
    middle = middles[len(middles) // 2]
    near = {name: span for name, span in spans.items() if abs(sum(span) / 2 - middle) < 86_400}
    start, end = min(a for a, _ in near.values()), max(b for _, b in near.values())
    scale = 560 / max(end - start, 1e-9)
    rows = []
    for i, name in enumerate(sorted(spans)):
        y = 18 * i
        label = f"<text x=345 y={y + 12} text-anchor=end>{html.escape(name[-52:])}</text>"
        if name in near:
            a, b = near[name]
            x, width = 355 + (a - start) * scale, max(2.0, (b - a) * scale)
            bar = f"<rect x={x:.1f} y={y + 3} width={width:.1f} height=11 rx=2 fill='#3b6ea8'/>"
        else:
            bar = f"<text x=355 y={y + 12}>another clock: {spans[name][0]:.0f} s</text>"
        rows.append(label + bar)
    height = 18 * len(spans) + 18
    axis = f"<text x=355 y={height - 4}>0 s</text><text x=915 y={height - 4} text-anchor=end>{end - start:.1f} s</text>"
    return f"<svg viewBox='0 0 920 {height}' width=100%>{''.join(rows)}{axis}</svg>"


def _bars(heights: Sequence[float], titles: Sequence[str], ends: tuple[str, str]) -> str:
    width, most = 880 / len(heights), max(heights) or 1
    bars = "".join(
        f"<rect x={20 + i * width:.1f} y={130 - 120 * height / most:.1f} width={max(1, width - 1):.1f} "
        f"height={120 * height / most:.1f} fill='#3b6ea8'><title>{title}</title></rect>"
        for i, (height, title) in enumerate(zip(heights, titles, strict=True))
        if height
    )
    scale = f"<text x=20 y=148>{ends[0]}</text><text x=900 y=148 text-anchor=end>{ends[1]}</text>"
    line = "<line x1=20 x2=900 y1=130 y2=130 stroke='#a0aec0'/>"
    return f"<svg viewBox='0 0 920 155' width=100%>{bars}{scale}{line}</svg>"
