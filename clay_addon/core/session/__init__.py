# SPDX-License-Identifier: GPL-3.0-or-later
"""The parts of a live session that need no Blender: its pace, its solver thread, its strokes.

A live session has these threads. Each owns what it works on while it works; results and orders pass
between the main thread and the others only, never between two of the others.

Blender's main thread
    Owns Blender's data and runs `SculptSession.tick`. It touches the solver (poses, hands,
    snapshots) only while the solver thread is idle. It never waits during a tick.

``clay-sculpt`` (`SolverWorker`), from the first build
    Owns the solver from `begin` until the result is ready for `take`: it loads the kernels, builds
    and steps. At the end of the session, a step in progress is waited for. Kernels that are still
    being compiled are not: the thread ends after them and the result is dropped.

``clay surface`` (`SurfaceWorker`), from the first tick after the clay was built
    Owns the `QuickSurface`, and copies of the positions it was offered. `LiveSurface.close` ends it
    and waits for the surface in progress, at most 5 s. A build with other clay objects closes it
    and starts a new one. It is a daemon.

``clay-autosave`` (`Autosave`), from the first save
    Owns copies of the arrays that it writes and the partial file. `Autosave.close` waits for the
    last write, then removes the file.

``clay-take`` (`TakeWriter`), only while a take is recorded
    Owns the take's folder: every file in it is written here after the first ones. The end of the
    take, or a take that cannot begin, waits until everything is written that can be. It is a
    daemon.

The solver and the surface both launch Warp kernels; `recording_lock` keeps them apart where Warp
does not allow that. The solver shares its passes on the CPU with one helper thread
(`solver.core.threads`), which is made once and ends with the process. The ultrasound array and the
trackers run in processes, not in threads of the session.

The four threads above end in `SculptSession.finish`, and all ways out of a session lead there: Esc
and Finish, an exception in a tick, loading another file (``load_pre``), closing the window, and
disabling the extension. If `finish` itself fails, it still ends each thread before it raises.
"""
