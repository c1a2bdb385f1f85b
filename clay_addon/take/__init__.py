# SPDX-License-Identifier: GPL-3.0-or-later
"""Takes: recorded live sessions.

Recording: `recorder` takes the session's steps, `pose` reads hands and tools from the scene, and
`steps` collects them for the files. Reading: `store` puts a take on the timeline with the keyframes
of `keys`; `film`, `film_scene` and `film_edits` bake it again with finer clay.
"""
