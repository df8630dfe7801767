"""Three people at once: annotate, submit, send back with a comment, correct, accept."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from sessions.commands import NamePart, SetJoint
from sessions.store import Store
from tests.browser.browsing import Tab, log_in
from tests.builders import wait_until, write_cupboard
from tests.sessions.people import PASSWORD, add_people


class PersonTab(Tab):
    """A tab whose application is found by the person's name: several are open at once."""

    name = ""

    @property
    def app(self) -> Any:
        return wait_until(
            lambda: next(
                (a for a in list(self.server.apps.values()) if a.tab.user == self.name), None
            ),
            f"the tab of {self.name}",
        )

    def says(self, text: str) -> None:
        """Wait until the page shows a text."""
        self.page.get_by_text(text).first.wait_for()

    def marked(self, text: str) -> None:
        """Wait until the marker of a comment says its text, which only the chosen one does."""
        name = f"/comment/{text.partition(':')[0]}/label"
        handle = self.app.tab.client.scene.get_handle_by_name

        def shown() -> bool:
            label = handle(name)
            return label is not None and label.text == text

        wait_until(shown, f"the marker says {text}", 60)
        self.wait_node(name)


@pytest.fixture
def server(start: Any, tmp_path: Path) -> Any:
    """A server with a cupboard and accounts."""
    store = Store(tmp_path / "workspace")
    add_people(store)
    store.close()
    return start(write_cupboard(tmp_path / "cupboard"), predictor="geometric")


@pytest.fixture
def come(server: Any, open_page: Any) -> Callable[[str], PersonTab]:
    """``come(name)`` logs a person in, in a browser of their own."""

    def begin(name: str) -> PersonTab:
        page = open_page(server.url)
        log_in(page, server, name, PASSWORD)
        tab = PersonTab(page, server)
        tab.name = name
        return tab.ready()

    return begin


def test_three_people_make_one_asset(server: Any, come: Callable[[str], PersonTab]) -> None:
    people = server.app_state.store.people
    ann = come("ann")
    wait_until(lambda: ann.document.segmentation_current and ann.object.asset, "parts")
    ann.key("p")
    wait_until(lambda: ann.document.tree is not None, "joints")
    ann.step("Review")
    ann.says("Submit (Y)")
    assert not ann.button("Reject (X)").is_visible(), "who annotates isn't asked for a reason"
    ann.wait_seen()
    ann.key("y")
    wait_until(lambda: ann.document.review.state == "submitted", "submitted")

    rob, bob = come("rob"), come("bob")
    rob.says("Also here: ann")
    bob.says("Also here: ann")
    rob.step("Review")
    rob.field("Comment").fill("opens too far")
    rob.choose("Comment on", "part 1")
    rob.drawn()
    rob.wait_seen()
    rob.key("Escape")
    rob.button("Reject (X)").click()
    rob.page.get_by_text("1 range", exact=True).click()
    wait_until(lambda: rob.document.review.state == "rejected", "sent back")
    review = rob.document.review
    assert (review.by, review.comment, review.joint) == ("rob", "opens too far", "link_1")

    # Back at ann, who sees why; bob, a second annotator, is kept out while she corrects it.
    ann.says("opens too far")
    joint = ann.document.tree.joint_of["link_1"]
    smaller = type(joint)(
        **{**vars(joint), "upper": joint.lower + 0.5 * (joint.upper - joint.lower)}
    )
    ann.app.tab.act(lambda: ann.app.tab.do(SetJoint(smaller)))
    wait_until(lambda: ann.document.tree.joint_of["link_1"] == smaller, "corrected")
    bob.app.tab.act(lambda: bob.app.tab.do(SetJoint(joint)))
    bob.says("ann works on this object now")
    assert ann.document.tree.joint_of["link_1"] == smaller
    ann.step("Review")
    ann.wait_seen()
    ann.key("y")
    wait_until(lambda: ann.document.review.state == "submitted", "submitted again")

    # A session that is revoked leads back to the login.
    people.credentials.revoke(people.accounts.find("bob"), "mia")
    bob.page.wait_for_url("**/login")

    accept(rob)
    assert rob.document.review.by == "rob"


def accept(rob: PersonTab) -> None:
    """Look at the checks, and accept whatever they say."""
    rob.step("Review")
    wait_until(lambda: rob.object.validation.report is not None, "checks")
    rob.app.review.validation_list.show_worst()
    rob.drawn()
    if rob.page.get_by_label("Reason for override").is_visible():
        rob.field("Reason for override").fill("a test")
        rob.drawn()
    rob.wait_seen()
    rob.page.get_by_role("button", name="Accept").first.click()
    wait_until(lambda: rob.document.review.state == "accepted", "accepted")


def test_a_manager_sets_instructions_and_labels_which_an_annotator_works_by(
    server: Any, come: Callable[[str], PersonTab]
) -> None:
    ann, mia = come("ann"), come("mia")
    assert not ann.button("Instructions (Shift+I)").is_visible()
    mia.page.get_by_role("button", name="Project", exact=True).click()
    mia.page.locator(".aw-project ul, .aw-project p").first.wait_for()
    mia.button("Instructions and labels").click()
    mia.type_at_once(
        {
            "Name": "Kitchens",
            "Instructions": "# Doors\nClick the *front*, never the frame.",
            "Labels": "Oven: door, knob\nCupboard: door, shelf",
        }
    )
    mia.page.get_by_label("Only these names").check()
    mia.button("Save").click()
    mia.says("The settings are saved")
    settings = server.app_state.store.project.settings
    assert (settings.name, settings.strict) == ("Kitchens", True)
    assert settings.part_names("Oven") == ("door", "knob")

    # Ann reads them beside the picture, and is offered the names.
    wait_until(lambda: ann.document.segmentation_current and ann.object.asset, "parts")
    ann.step("Annotate")
    ann.button("Instructions (Shift+I)").wait_for()
    ann.wait_for_keyboard()
    ann.key("Shift+I")
    ann.page.locator(".aw-instructions em", has_text="front").wait_for()
    ann.choose("Category", "Cupboard")
    wait_until(lambda: ann.document.category == "Cupboard", "the category")
    ann.key("Shift+I")
    ann.page.locator(".aw-instructions").wait_for(state="hidden")
    ann.key("1")
    ann.key("p")
    wait_until(lambda: ann.document.tree is not None, "joints")
    ann.app.tab.act(lambda: ann.app.tab.do(NamePart(1, "wing")))
    ann.step("Review")
    ann.says("isn't in the project's labels")
    ann.step("Annotate")
    ann.choose("Part name", "shelf")
    wait_until(lambda: ann.document.part_names.get(1) == "shelf", "the second name of the list")
    ann.step("Review")
    ann.page.get_by_text("isn't in the project's labels").first.wait_for(state="detached")


def test_a_reviewer_pins_a_comment_which_the_annotator_finds_in_3d(
    come: Callable[[str], PersonTab],
) -> None:
    rob = come("rob")
    wait_until(lambda: rob.document.segmentation_current and rob.object.asset, "parts")
    rob.key("p")
    wait_until(lambda: rob.document.tree is not None, "joints")
    rob.step("Review")
    wait_until(lambda: rob.object.validation.report is not None, "checks")
    rob.button("Pin in 3D").click()
    rob.says("write the comment first")
    rob.field("Comment").fill("a scratch")
    rob.drawn()
    rob.button("Pin in 3D").click()
    wait_until(lambda: rob.app.pointing.armed == "comment", "the place is asked for")
    rob.camera_at_rest()
    bounds = rob.object.asset.bounds
    aim = bounds.mean(axis=0)
    rob.click3d(aim)
    wait_until(lambda: rob.document.comments, "the comment is pinned")
    (comment,) = rob.document.comments
    assert (comment.text, comment.by, comment.done) == ("a scratch", "rob", False)
    assert all(bounds[0] - 0.01 <= comment.place) and all(comment.place <= bounds[1] + 0.01)
    rob.choose("Comment on", "part 1")
    rob.field("Comment").fill("too far")
    rob.drawn()
    rob.wait_seen()
    rob.key("Escape")
    rob.button("Reject (X)").click()
    rob.page.get_by_text("1 range", exact=True).click()
    wait_until(lambda: rob.document.review.state == "rejected", "sent back")

    # The annotator sees numbers in the picture, and steps through them.
    ann = come("ann")
    ann.says("Comments: 2 of 2 open")
    for number in (1, 2):
        ann.wait_node(f"/comment/{number}/label")
    ann.key("Shift+C")
    ann.marked("1: a scratch")
    ann.button("Comment 1 is done").click()
    wait_until(lambda: ann.document.comments[0].done, "it is done")
    ann.says("Comments: 1 of 2 open")
    ann.marked("2: too far")
    assert ann.selection.child == "link_1", "the next one is about a joint, which is chosen"
    # A click on a marker shows what it says, and is no prompt.
    ann.step("Annotate")
    ann.button("Comment 1: a scratch").click()
    ann.marked("1: a scratch")
    prompts = len(ann.document.prompts)
    ann.camera_at_rest()
    ann.click3d(ann.document.tree.joint_of["link_1"].origin)
    ann.marked("2: too far")
    assert len(ann.document.prompts) == prompts
