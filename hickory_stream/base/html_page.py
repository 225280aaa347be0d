"""One HTML file without network access: frame, style and pictures of all pages."""

import base64
import html

import cv2
import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.terminal import visible

_JPEG_QUALITY = 86
_STYLE = """
:root { color-scheme: light dark; --ink: #1d2330; --soft: #667; --line: #d5d9e2; --card: #fff; --back: #f3f4f7;
  --bad: #c8452f; --fair: #d9a13a; --good: #4b9a5b; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e7e9ee; --soft: #9aa3b5; --line: #343b4a; --card: #1e232e; --back: #14171e; }
}
body { font: 15px/1.45 system-ui, sans-serif; color: var(--ink); background: var(--back); margin: 2rem auto;
  max-width: 1180px; padding: 0 1rem; }
h1 { font-size: 1.5rem; margin: 0 0 .2rem; } h2 { font-size: 1.15rem; margin: 2rem 0 .6rem; }
table { border-collapse: collapse; } th { text-align: left; font-weight: 600; color: var(--soft); }
td.n, th.n { font-variant-numeric: tabular-nums; white-space: nowrap; }
.soft { color: var(--soft); } code { font-size: .85em; }
"""


def page(title: str, body: str, style: str = "") -> str:
    """Return a page of `body`, which is HTML; `title` is plain text, `style` is further CSS.

    Control characters, e.g. of names in logs, are escaped (`base.terminal`).
    """
    head = '<!doctype html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
    shown = f"<title>{html.escape(title)}</title><style>{_STYLE}{style}</style><body>{body}</body></html>\n"
    return visible(head + shown)


def picture(rgb: NDArray[np.uint8], alt: str, longest_px: int) -> str:
    """Return an img element with the picture (H x W x 3), reduced to `longest_px` a side."""
    scale = longest_px / max(rgb.shape[:2])
    if scale < 1:
        size = (max(1, round(rgb.shape[1] * scale)), max(1, round(rgb.shape[0] * scale)))
        rgb = np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    bgr = np.ascontiguousarray(rgb[..., ::-1])
    encoded = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1]
    data = base64.b64encode(encoded.tobytes()).decode()
    return f'<img alt="{html.escape(alt)}" src="data:image/jpeg;base64,{data}">'
