"""The lexicon: what descriptions say about objects."""

import pytest

from model.scenes.articulable_finders import LexiconFinder, read_lexicon
from model.scenes.scene import ArticulableFinder, ObjectDescription


@pytest.fixture(scope="module")
def finder() -> LexiconFinder:
    return LexiconFinder()


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("a white kitchen cabinet with two doors", "cabinet"),
        ("CabinetLower", "cabinet"),
        ("refridgerator", "refrigerator"),
        ("Microwave Oven", "microwave"),
        ("wooden bookshelf with drawers", "shelf"),
        ("bottles", "bottle"),
        ("oven counter", "oven"),
        ("swivel chair", "office chair"),
        ("pair of scissors", "scissors"),
        ("Chest of Drawers", "chest of drawers"),
        ("a coffee table with a drawer", "table"),
        ("a laptop by Dell", "laptop"),
        ("a wooden wardrobe 2m tall", "wardrobe"),
        ("a 1.8 m x 2 m wardrobe", "wardrobe"),
        ("a glass door leading to the balcony", "door"),
        ("a door to the garden", "door"),
        ("a laptop [closed]", "laptop"),
        ("a laptop closed", "laptop"),
        ("a built-in oven", "oven"),
        ("side by side refrigerator", "refrigerator"),
        ("floor to ceiling cabinet", "cabinet"),
        # As nodes are called by those who made a scene, and by what exported it.
        ("cabinet_white_02", "cabinet"),
        ("Kitchen_Cabinet_Wood.001", "cabinet"),
        ("SM_Dishwasher_LOD0", "dishwasher"),
        ("washing_machine_mesh", "washing machine"),
        ("oven_lowpoly_v2", "oven"),
    ],
)
def test_found(finder: LexiconFinder, text: str, kind: str) -> None:
    (decision,) = finder.find([ObjectDescription(text)])
    assert decision.articulable and decision.kind == kind
    assert decision.parts and text in decision.reason and decision.base in ("fixed", "free")


STILL = """oven mitt|banana|a rug under the cabinet|dining table|wooden chair||pan|door mat|vase
|picture of a fridge|oven_mitt_white|cabinet_handle_metal|white_mesh|wood"""


@pytest.mark.parametrize("text", STILL.replace("\n", "").split("|"))
def test_left_rigid_with_a_reason(finder: LexiconFinder, text: str) -> None:
    (decision,) = finder.find([ObjectDescription(text)])
    assert not decision.articulable and decision.reason


def test_the_category_counts_before_the_description(finder: LexiconFinder) -> None:
    (decision,) = finder.find([ObjectDescription("model 7128", "Microwave")])
    assert decision.articulable and "category" in decision.reason


def test_it_is_a_finder_and_its_words_are_unique(finder: LexiconFinder) -> None:
    assert isinstance(finder, ArticulableFinder)
    words = [w for k in read_lexicon().kinds for w in k.words]
    assert sorted({w for w in words if words.count(w) > 1}) == []
