"""Commands about the kinematic tree; see :mod:`sessions.commands`."""

from __future__ import annotations

from dataclasses import dataclass, replace

from model.core.articulated_object import Prediction
from model.core.composite_joints import Composite, with_composite
from model.core.errors import CommandError
from model.core.joint import Joint
from model.core.tree import KinematicTree, holds_part, replace_joint, with_chain_of
from sessions.checks import check_ref
from sessions.document import Document
from sessions.part_commands import still_locked, with_new_parts
from sessions.review import Action
from sessions.state import Command, Context

Edited = tuple[KinematicTree, frozenset[str]]
"""A tree, and the child links of its locked joints."""


@dataclass(frozen=True)
class RecordPrediction(Command, kind="record_prediction", words="prediction"):
    """A predictor's result.

    Attributes:
        prediction: the answer; without a tree it changes no joint.
        segmentation: reference of the labels that it was made for.
    """

    prediction: Prediction
    segmentation: str

    def __post_init__(self) -> None:
        check_ref(self.segmentation, "segmentation")

    @property
    def action(self) -> Action:
        return "adjust" if self.prediction.tree is None else "predict"

    def edit(self, document: Document, context: Context) -> Document:
        if document.segmentation is None:
            # The parts were deleted during the prediction.
            return document
        after = replace(document, prediction=self.prediction, joint_edits=0)
        tree = self.prediction.tree
        if tree is None:
            return after
        locked = still_locked(document.locked, tree)
        after = replace(after, prediction_for=self.segmentation, tree=tree, locked=locked)
        return with_new_parts(after)


class JointEdit(Command, action="adjust"):
    """An edit of the tree, or of its locks."""

    def edit(self, document: Document, context: Context) -> Document:
        tree = document.tree
        if tree is None:
            raise CommandError("there is no kinematic tree to edit; predict it first")
        after, locked = self._edited(document, tree)
        if (after, locked) == (tree, document.locked):
            return document
        edits = document.joint_edits + (after != tree)
        return replace(document, tree=after, locked=locked, joint_edits=edits)

    def _edited(self, document: Document, tree: KinematicTree) -> Edited:
        """Return the tree after it, and the child links locked then."""
        raise NotImplementedError


@dataclass(frozen=True)
class SetJoint(JointEdit, kind="set_joint", words="change joint {joint.name}"):
    """Replace the joint of ``joint.child``: type, axis, origin, limits, name or parent."""

    joint: Joint

    def _edited(self, document: Document, tree: KinematicTree) -> Edited:
        return replace_joint(tree, self.joint), document.locked


@dataclass(frozen=True)
class SetComposite(JointEdit, kind="set_composite"):
    """Let the part ``child`` move by one joint, or by a chain of several.

    Attributes:
        child: link of the part.
        motion: kind, and the pitch of a screw.
    """

    child: str
    motion: Composite

    def describe(self) -> str:
        words = self.motion.kind.replace("_", " ").replace("single", "one joint")
        return f"{self.child} moves by {words}"

    def _edited(self, document: Document, tree: KinematicTree) -> Edited:
        after = with_composite(tree, self.child, self.motion, holds_part)
        return after, still_locked(document.locked, after)


@dataclass(frozen=True)
class SetRoot(JointEdit, kind="set_root", words="make {link} the root"):
    """Make ``link`` the root; the joints on the path to the former root are reversed."""

    link: str

    def _edited(self, document: Document, tree: KinematicTree) -> Edited:
        after, turned = tree.rerooted(self.link), tree.path_to_root(self.link)
        parents = {tree.joint_of[c].parent for c in turned if c in document.locked}
        return after, (document.locked - frozenset(turned)) | parents


@dataclass(frozen=True)
class ResetJoint(JointEdit, kind="reset_joint", words="reset the joint of {child}"):
    """Reset the joint of ``child`` to the predicted one."""

    child: str

    def _edited(self, document: Document, tree: KinematicTree) -> Edited:
        prediction = document.prediction
        joint = None if prediction is None else prediction.joint(self.child)
        if prediction is None or joint is None:
            raise CommandError(f"no joint was predicted for {self.child!r}")
        if prediction.tree is not None:
            tree = with_chain_of(tree, prediction.tree, self.child)
        return replace_joint(tree, joint), document.locked


@dataclass(frozen=True)
class LockJoint(JointEdit, kind="lock_joint"):
    """Lock or unlock the joint of ``child``: the next prediction keeps a locked joint."""

    child: str
    locked: bool

    def describe(self) -> str:
        return f"{'lock' if self.locked else 'unlock'} the joint of {self.child}"

    def _edited(self, document: Document, tree: KinematicTree) -> Edited:
        one = frozenset({self.child})
        if self.child not in tree.joint_of:
            known = ", ".join(tree.joint_of)
            raise CommandError(f"no joint moves a link {self.child!r}; links with a joint: {known}")
        return tree, document.locked | one if self.locked else document.locked - one
