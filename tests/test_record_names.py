import dataclasses
import json
from enum import Enum
from pathlib import Path
from hickory_stream.journal.record_codec import record_classes

FROZEN = Path(__file__).parent / "golden" / "record_names.json"


def test_journal_records_keep_their_names_and_fields():
    """A journal written before names them: a name changes only with an alias on reading, and then here."""
    found = {
        name: [member.value for member in kind]
        if issubclass(kind, Enum)
        else [f.name for f in dataclasses.fields(kind)]
        for name, kind in sorted(record_classes().items())
    }
    assert found == json.loads(FROZEN.read_text(encoding="utf-8"))
