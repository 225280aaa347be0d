"""The grammar of questions: a small part of English, read from left to right.

```
question  = [how many | count | number of] thing
thing     = { word } [noun] { clause }
word      = colour | size | shape | superlative | not word
clause    = [not] ( relation landmark | larger than LENGTH | to sit on | to put things on | word )
landmark  = thing | object ID | #ID | X,Y | the floor | a wall
```

A clause belongs to the thing just before it, after "and" to the first thing. A word outside of `vocabulary.py` is
refused by name, since an answer without it would be misleading. With an image-text network such words describe the
looks of a thing ("coffee mug"), beside the noun after them: an "office chair" is a chair, too.
"""

import re
from collections.abc import Mapping
from difflib import get_close_matches

from hickory_stream.errors import InputError
from hickory_stream.query import vocabulary as words
from hickory_stream.query.question import (
    Condition,
    HasMeasure,
    LooksLike,
    Most,
    Not,
    ObjectOfId,
    Place,
    Question,
    Related,
    Relation,
    Room,
    Serves,
    Thing,
)

_TOKEN = re.compile(r"#\d+|-?\d+(?:\.\d+)?,\s*-?\d+(?:\.\d+)?|\d+(?:\.\d+)?|[^\W\d_]+|\S")
_PLACE = re.compile(r"(-?[\d.]+),\s*(-?[\d.]+)")
_LENGTH_SLACK = 0.05
_MOST_CHARACTERS = 500
# A word of five letters with two swapped is a misspelling; "wine" is not "wide".
_ALIKE = 0.8


def question_of(text: str, *, with_looks: bool = False) -> Question:
    """Return the question of a text; `with_looks` makes unknown words the looks of a thing.

    Raises `InputError` for an unknown word (`UnknownWord`), or an incomplete text.
    """
    if len(text) > _MOST_CHARACTERS:
        raise InputError(f"found a question of {len(text)} characters, expected at most {_MOST_CHARACTERS}")
    return _Reader(text, with_looks).question()


class UnknownWord(InputError):
    """A word is in none of the tables; only a network could interpret it."""


class _Reader:
    def __init__(self, text: str, with_looks: bool) -> None:
        self._text = text
        self._with_looks = with_looks
        self._nouns = words.NOUNS if with_looks else {**words.NOUNS, **words.STAND_INS}
        self._tokens = [token for token in _TOKEN.findall(text.lower()) if token not in "?.!;:'\""]
        self._at = 0
        self._is_of_first = False

    def question(self) -> Question:
        self._skip_fillers()
        counts = any(self._takes(phrase) for phrase in words.COUNTING)
        if self._at == len(self._tokens):
            raise InputError(f'found the question "{self._text}", expected what to look for, e.g. "a red box"')
        return Question(thing=self._thing(depth=0), counts=counts)

    def _thing(self, depth: int) -> Thing:
        conditions: list[Condition] = []
        while self._at < len(self._tokens):
            if self._peek() == "and":
                self._at += 1
                # "a red and blue box" is about the box, "on a box and near ..." no more.
                self._is_of_first = not self._is_adjective_next()
            elif not self._skip_fillers():
                is_not = self._takes(("not",))
                said = self._conditions(depth)
                conditions += (Not(thing=Thing(conditions=said)),) if is_not else said
            if self._is_of_first and depth > 0:
                break
            self._is_of_first = False
        return Thing(conditions=tuple(conditions))

    def _conditions(self, depth: int) -> tuple[Condition, ...]:
        for phrase, use in words.USES.items():
            if self._takes(phrase):
                return (Serves(use=use),)
        for phrase, relation in words.RELATIONS.items():
            if self._takes(phrase):
                return (Related(relation=relation, to=self._landmark(relation, depth)),)
        word = self._next()
        if word in words.ADJECTIVES:
            return (words.ADJECTIVES[word],)
        if word in words.COMPARISONS:
            return (self._comparison(word),)
        if word in words.SUPERLATIVES:
            quantity, is_least = words.SUPERLATIVES[word]
            return (Most(name=word, quantity=quantity, is_least=is_least),)
        if word in words.NEAREST:
            return (self._nearest(depth),)
        if (said := _noun(word, self._nouns)) is not None:
            return said
        if self._with_looks and word.isalpha():
            return self._looks(word)
        raise UnknownWord(self._unknown(word))

    def _looks(self, word: str) -> tuple[Condition, ...]:
        said = [word]
        while self._at < len(self._tokens) and self._peek().isalpha() and not self._is_known(self._peek()):
            said.append(self._next())
        noun = _noun(self._peek(), self._nouns) if self._at < len(self._tokens) else None
        if noun:
            said.append(self._next())
        return (LooksLike(text=" ".join(said)), *(noun or ()))

    def _nearest(self, depth: int) -> Most:
        # The landmark of "nearest" follows "to", wherever that is.
        if "to" not in self._tokens[self._at :]:
            raise InputError('found "nearest", expected "nearest to" and a place, an object or a thing')
        to = self._tokens.index("to", self._at)
        rest, self._tokens = self._tokens[self._at : to], [*self._tokens[: self._at], *self._tokens[to + 1 :]]
        landmark = self._landmark(Relation.NEAR, depth)
        self._tokens[self._at : self._at] = rest
        if isinstance(landmark, str):
            raise InputError(f'found "nearest to the {landmark}", expected a place, an object or a thing')
        return Most(name="nearest", quantity=None, nearest_to=landmark)

    def _landmark(self, relation: Relation, depth: int) -> Thing | ObjectOfId | Place | Room:
        self._skip_fillers()
        if self._at == len(self._tokens):
            raise InputError(f'found "{self._text}", which ends after "{relation}"; expected what it is {relation}')
        token = self._peek()
        if token in words.ROOM_WORDS:
            self._at += 1
            return "floor" if words.ROOM_WORDS[token] == "floor" else "wall"
        if found := _PLACE.fullmatch(token):
            self._at += 1
            return Place(x=float(found[1]), y=float(found[2]))
        if token.startswith("#"):
            self._at += 1
            return ObjectOfId(id=int(token[1:]))
        if token == "object" and self._at + 1 < len(self._tokens) and self._tokens[self._at + 1].isdigit():
            self._at += 2
            return ObjectOfId(id=int(self._tokens[self._at - 1]))
        return self._thing(depth + 1)

    def _comparison(self, word: str) -> HasMeasure:
        self._takes(("than",))
        number = self._next(f'a length after "{word} than", e.g. 0.5 m')
        try:
            value = float(number)
        except ValueError as error:
            raise InputError(f'found "{word} than {number}", expected a length, e.g. {word} than 0.5 m') from error
        unit = self._peek() if self._at < len(self._tokens) else ""
        if unit in words.UNITS_M:
            self._at += 1
        value_m = value * words.UNITS_M.get(unit, 1.0)
        quantity, is_more = words.COMPARISONS[word]
        slack = max(_LENGTH_SLACK * value_m, 1e-3)
        ends = (value_m - slack, value_m + slack)
        zero_at, one_at = ends if is_more else ends[::-1]
        return HasMeasure(name=f"{word} than {value_m:g} m", quantity=quantity, zero_at=zero_at, one_at=one_at)

    def _is_adjective_next(self) -> bool:
        word = self._tokens[self._at] if self._at < len(self._tokens) else ""
        return word in words.ADJECTIVES

    def _skip_fillers(self) -> bool:
        before = self._at
        while self._at < len(self._tokens) and self._peek() in words.FILLERS and self._peek() != "and":
            self._at += 1
        return self._at > before

    def _takes(self, phrase: tuple[str, ...]) -> bool:
        if tuple(self._tokens[self._at : self._at + len(phrase)]) != phrase:
            return False
        self._at += len(phrase)
        return True

    def _peek(self) -> str:
        return self._tokens[self._at]

    def _next(self, expected: str = "a word") -> str:
        if self._at == len(self._tokens):
            raise InputError(f'found "{self._text}", which ends too early; expected {expected}')
        self._at += 1
        return self._tokens[self._at - 1]

    def _is_known(self, word: str) -> bool:
        tables = (
            words.ADJECTIVES,
            words.COMPARISONS,
            words.SUPERLATIVES,
            words.NEAREST,
            words.FILLERS,
            words.ROOM_WORDS,
        )
        in_table = any(word in table for table in tables)
        return in_table or _begins_clause(word) or _noun(word, self._nouns) is not None

    def _unknown(self, word: str) -> str:
        # Suggested is what could stand here: before a thing a property or the thing, at the end a thing.
        is_last = self._at == len(self._tokens) or _begins_clause(self._peek())
        possible = [*self._nouns, *(() if is_last else (*words.ADJECTIVES, *words.SUPERLATIVES))]
        counting = [" ".join(phrase) for phrase in words.COUNTING if phrase[0] == word]
        near = counting or get_close_matches(word, possible, n=2, cutoff=_ALIKE)
        meant = f" (did you mean {' or '.join(near)}?)" if near else ""
        # Of synonyms, the first.
        things = {conditions: noun for noun, conditions in reversed(self._nouns.items()) if conditions}.values()
        known = "" if near else f"; things that they define: {', '.join(sorted(things))}"
        return f'found the word "{word}"{meant}, which size, shape, colour and place of objects do not define{known}'


def stands_in(text: str) -> bool:
    """Return whether geometry stands in for the looks of a thing of the text."""
    return any(_noun(word, words.STAND_INS) is not None for word in _TOKEN.findall(text.lower()))


def _noun(word: str, nouns: Mapping[str, tuple[Condition, ...]]) -> tuple[Condition, ...] | None:
    forms = (word, word.removesuffix("s"), word.removesuffix("es"), re.sub("ves$", "f", word))
    return next((nouns[form] for form in forms if form in nouns), None)


def _begins_clause(word: str) -> bool:
    return word in {"and", "not", *words.COMPARISONS, *(phrase[0] for phrase in (*words.RELATIONS, *words.USES))}
