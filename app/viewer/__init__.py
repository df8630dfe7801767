"""The browser screens. Imports go one way, from top to bottom:

- ``client_app``: makes the screens of one tab and connects them; ``PANELS`` there lists panels
- ``commands``, then ``navigation``: the commands of keys and buttons, and opening objects
- ``steps``: what each step of the work shows: annotate, joints, review, and a whole scene
- ``panels``: groups of widgets; they get the tab, values and callbacks, never a step
- ``input``: pointer, tools, keys, and the guard before decisions
- ``picture``: what is drawn in 3D
- ``tab``: the browser, its user, the selection and the two threads
- ``words``: all texts, one file a screen
"""
