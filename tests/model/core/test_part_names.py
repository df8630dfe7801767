"""Names and categories to mechanisms, however people write them."""

import pytest

from model.core.motion_lexicon import CATEGORY_WORDS, MECHANISMS, SLIDING, TURNING, WORDS
from model.core.names import (
    base_score,
    category_key,
    category_remark,
    mechanism_of,
    mechanisms_of,
    words,
)
from model.prediction.geometric.mechanisms import BUILDERS


@pytest.mark.parametrize(
    ("name", "category", "expected"),
    [
        ("door", None, "hinge"),
        ("Left Door", None, "hinge"),
        ("left_door_2", "StorageFurniture", "hinge"),
        ("doors", None, "hinge"),
        ("rotation_door", "Dishwasher", "drop"),
        ("translation_door", "Door", "slide_along"),
        ("sliding door", "cabinet", "slide_along"),
        ("oven door", "Oven", "drop"),
        ("drawer", None, "slide_out"),
        ("Drawr", None, "slide_out"),
        ("lid", None, "flap"),
        ("lid", "Bottle", "screw"),
        ("lid", "KitchenPot", "lift"),
        ("lid", "kitchen pot", "lift"),
        ("translation_lid", "Bottle", "lift"),
        ("rotation_lid", "Bottle", "screw"),
        ("rotation_tray", "Microwave", "swivel"),
        ("tray", "Oven", "slide_out"),
        ("toggle_button", "Switch", "toggle"),
        ("pressing_lid", "Dispenser", "press"),
        ("castor", "Chair", "swivel"),
        ("front wheel", "Cart", "spin"),
        ("nonsense", None, None),
        ("", None, None),
        (None, None, None),
    ],
)
def test_mechanism(name, category, expected) -> None:
    assert mechanism_of(name, category)[0] == expected


@pytest.mark.parametrize(
    ("name", "category", "expected"),
    [
        ("drawer door", None, ("hinge", "slide_out")),
        ("sliding drawer door", None, ("slide_along",)),
        ("toggle_button", "Switch", ("toggle",)),
        ("door", None, ("hinge",)),
        ("upper left", None, ()),
        (None, None, ()),
    ],
)
def test_all_words_of_a_name_are_heard(name, category, expected) -> None:
    assert mechanisms_of(name, category) == expected


def test_the_base_is_told_from_what_moves() -> None:
    assert base_score("furniture_body", None) > 1
    assert base_score("frame", None) > 1
    assert base_score("stapler_base", None) > base_score("stapler_body", None) > 0
    assert base_score("rotation_body", "USB") < 0
    assert base_score("door", None) < 0
    assert base_score(None, None) == 0


def test_words_are_split() -> None:
    assert words("RotationDoor-2 left") == ("rotation", "door", "left")


@pytest.mark.parametrize(
    ("given", "key"),
    [
        ("Kitchen Pot", "kitchenpot"),
        ("fridge", "refrigerator"),
        ("Plier", "pliers"),
        ("cupbord", "storagefurniture"),
        ("??", ""),
    ],
)
def test_categories(given: str, key: str) -> None:
    assert category_key(given) == key


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("Refridgerator", "taken for 'refrigerator'"),
        ("cabnit", "did you mean 'cabinet'?"),
        ("Storage Furniture", ""),
        ("fridge", ""),
        ("Helicopter", ""),
        (None, ""),
    ],
)
def test_a_misspelt_category_is_told(given: str | None, said: str) -> None:
    told = category_remark(given)
    assert said in told if told else not said


def test_every_mechanism_of_the_tables_can_be_built() -> None:
    named = {*WORDS.values(), *TURNING.values(), *SLIDING.values()}
    named |= {m for table in CATEGORY_WORDS.values() for m in table.values()}
    assert named <= set(MECHANISMS) == set(BUILDERS)
