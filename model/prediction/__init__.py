"""The Predictor port and its implementations: geometry, Arti4URDF, a remote backend.

From labels to a URDF in six files (the default predictor, ``hybrid``):

1. ``model/geometry/parts.py``: ``split`` cuts an asset by its labels into rigid parts.
2. ``model/prediction/arti4urdf/predictor.py``: ``Arti4UrdfPredictor.predict`` runs steps 3 to 5 and
   collects the joints in a ``PredictionBuilder``.
3. ``model/prediction/arti4urdf/structure.py``: ``read_structure`` measures the parts and lets the
   rules of ``model/prediction/geometric`` propose candidate joints.
4. ``model/prediction/arti4urdf/choosing.py`` sums what rules and words say; ``decode`` of
   ``decoding.py`` adds the network's reading and chooses within the grammar.
5. ``model/prediction/arti4urdf/answer.py``: ``joints_of_decision`` turns the choices into joints,
   ``write_answer`` and ``parse_answer`` are the text form.
6. ``model/io/urdf/writer.py``: ``to_urdf_text`` writes the parts and their tree.
"""

DEFAULT = "hybrid"
"""Name of the default predictor: Arti4URDF beside geometry, with the weights in the repository."""


TOKEN_VARIABLE = "ARTIWORLD_BACKEND_TOKEN"
"""Environment variable with the backend's token, which keeps it out of process lists."""


def is_backend(name: str) -> bool:
    """True if a predictor's name is the address of a backend."""
    return name.startswith(("http://", "https://"))
