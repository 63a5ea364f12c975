"""A pool as a page: every object with a picture, flagged ones first, and nothing of it is taken for HTML."""

import re
from dataclasses import replace

from cluttergen_jax.assets.pool import Pool, write_pool
from cluttergen_jax.cli.main import main
from tests.helpers.drawing import GREEN, RED, needs_gl


@needs_gl
def test_a_page_shows_every_object_and_what_was_flagged(tmp_path, capsys):
    red = replace(RED, label="<b>a red cube</b>", notes=("turned & shrunk",))
    green = replace(GREEN, flags=("deviates by 9 %",))
    pool = write_pool(tmp_path / "cubes", Pool("cubes", (red, green)))
    assert main(["inspect", str(pool), "--out", str(tmp_path / "page.html")]) == 0
    page = (tmp_path / "page.html").read_text()
    assert re.findall("<h2>(.*?)</h2>", page) == ["green", "red"]
    assert page.count("data:image/jpeg;base64,") == 2
    assert "2 objects, 1 flagged" in page
    assert "deviates by 9 %" in page
    assert "&lt;b&gt;a red cube&lt;/b&gt;" in page
    assert "turned &amp; shrunk" in page
    assert "<b>" not in page
    assert main(["inspect", str(pool), "--objects", "r*", "--out", str(tmp_path / "one.html")]) == 0
    assert re.findall("<h2>(.*?)</h2>", (tmp_path / "one.html").read_text()) == ["red"]
    capsys.readouterr()
    assert main(["inspect", str(pool), "--grasps", "--out", str(tmp_path / "page.html")]) == 2
    assert "--grasps with an HTML page" in capsys.readouterr().err
