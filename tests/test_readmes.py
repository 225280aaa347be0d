import re
from operator import attrgetter
import pytest
from hickory_stream.settings import Settings
from tests.readmes import blocks_of, prose_of
from tools.readmes import READMES, RESULTS, ROOT

PACKAGES = sorted(
    path.parent
    for pattern in ("hickory_stream/*/__init__.py", "players/__init__.py", "players/live/__init__.py")
    for path in ROOT.glob(pattern)
)
# A README names files relative to its own folder, to the checkout, or to one of these packages.
PLACES = (ROOT, *(ROOT / folder for folder in ("hickory_stream", "tests", "tests/conformance", "tests/examples")))
NAMES = [str(readme.relative_to(ROOT)) for readme in READMES]


def test_the_main_readme_has_180_lines_at_most():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 180


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: str(package.relative_to(ROOT)))
def test_every_package_has_a_linked_readme(package):
    assert "How to extend it" in (package / "README.md").read_text(encoding="utf-8")
    assert f"]({package.relative_to(ROOT)}/README.md)" in (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("readme", READMES, ids=NAMES)
def test_lines_of_prose_have_120_characters_at_most(readme):
    assert [number for number, line in prose_of(readme) if len(line) > 120] == []


@pytest.mark.parametrize("readme", READMES, ids=NAMES)
def test_links_lead_to_files(readme):
    text = readme.read_text(encoding="utf-8")
    targets = [target for target in re.findall(r"\]\(([^)#]+)\)", text) if "://" not in target]
    assert [target for target in targets if not (readme.parent / target).exists()] == []


@pytest.mark.parametrize("readme", sorted({*READMES} - {*RESULTS}), ids=lambda readme: str(readme.relative_to(ROOT)))
def test_named_files_exist(readme):
    """Pages of results may name files that have been removed since."""
    text = re.sub(r"^```.*?^```", "", readme.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    named = set(re.findall(r"`([\w./-]+\.(?:py|toml))`", text)) | set(re.findall(r"`(tools/\w+)[` ]", text))
    places = (readme.parent, *readme.parent.parents, *PLACES)
    assert sorted(name for name in named if not any((place / name).exists() for place in places)) == []


def test_the_table_of_keys_has_the_defaults():
    """A name without a section shares the section before it."""
    text = (ROOT / "hickory_stream" / "cli" / "README.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (`(?:mapper|disk|rerun)\..*?) \| (.*?) ?\|", text, flags=re.MULTILINE)
    assert len(rows) >= 25
    for names, defaults in rows:
        keys = re.findall(r"`([\w.]+)`", names)
        sections = [key.rpartition(".")[0] or keys[0].rpartition(".")[0] for key in keys]
        values = [
            attrgetter(f"{section}.{key.rpartition('.')[2]}")(Settings())
            for section, key in zip(sections, keys, strict=True)
        ]
        if defaults and defaults != "profile":
            shown = [text.strip("`").split()[0] for text in defaults.split(", ")]
            assert shown == [f"{value:g}" if isinstance(value, float) else str(value) for value in values], names


@pytest.mark.parametrize("readme", READMES, ids=NAMES)
def test_python_blocks_compile(readme):
    compile(blocks_of("python", readme), str(readme), "exec")
