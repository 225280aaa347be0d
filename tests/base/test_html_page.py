import base64
import re
import cv2
import numpy as np
from hickory_stream.base.html_page import page, picture


def test_a_page_shows_what_a_stranger_wrote_and_loads_nothing():
    text = page("a<b>\x1b[2J", "<p>x\u202ey</p>", "p { color: red; }")
    assert "<title>a&lt;b&gt;\\x1b[2J</title>" in text
    assert "<p>x\\u202ey</p>" in text
    assert "p { color: red; }</style>" in text
    assert re.search(r"https?://|<script|<link", text) is None


def test_a_large_picture_is_made_smaller_and_keeps_its_colours():
    rgb = np.zeros((40, 80, 3), dtype=np.uint8)
    rgb[:, :, 0] = 200
    shown = picture(rgb, 'a "red" one', 20)
    assert 'alt="a &quot;red&quot; one"' in shown
    data = base64.b64decode(shown.split("base64,")[1].split('"')[0])
    read = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert read.shape == (10, 20, 3)
    np.testing.assert_allclose(read[5, 10], [0, 0, 200], atol=4)
