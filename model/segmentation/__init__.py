"""Promptable part segmentation: encode an asset once, then answer each click.

The way of a click to labels, in six files:

1. ``default.py``: ``DefaultSession.segment`` takes all prompts and caches a state after each.
2. ``prompt_steps.py``: ties each prompt to an element and a node, and enforces it at the end.
3. ``session_state.py``: what a click changes, from one state of all parts to the next.
4. ``solver.py``: one part: propose masks, describe them, score them, choose the best. It lists what
   objects and rooms use of each stage.
5. ``labels.py``: from superpoints to one label per face or point.
6. ``encoding.py``: what was computed once before: nodes, superpoints, trees, walks.

The stages: encode (``nodes``, ``graph``, ``superpoints``, ``encoding``), propose (``proposals``,
``plane_boxes``, ``boxes``, ``fronts``, ``front_rectangles``), describe (``mask_features``,
``object_features``), score (``scores``), finish (``labels``, ``facets``).
``mask_tools``, ``all_parts`` and ``similar`` make masks by other means than clicks.
"""
