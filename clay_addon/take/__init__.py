# SPDX-License-Identifier: GPL-3.0-or-later
"""Takes: recorded live sessions.

`recorder` records a session step by step; `pose` reads hands and tools from the scene, and `steps`
buffers them for the files. `store` puts a finished take on the timeline, with the keyframes of
`keys`. `film` and `film_scene` make a scene to bake it again with finer clay.
"""
