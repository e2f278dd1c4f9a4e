"""The handle editor: pick regions of a shape, drag them, watch it follow, export a proved mesh.

`implicit-warp view part.py` opens it in the browser; `docs/editor.md` says how it is used.

==================  ==========================================================================
`source`            the shape, its preview mesh, and whether its file has changed
`regions`           what the selection tools select, as fields: text that handle files can hold
`session`           the edit: handles, selection, undo and redo
`live_solver`       the thread that follows a drag, and solves in full after it
`export`            files, within the working folder
`autosave`          what a crash would lose
`page`              the page (viser, extra ``viewer``), and what ties the panels together
`..._panel`         the panels: 1 Select, 2 Handles, 3 Drag, 4 See, 5 Export
`shown`             the mesh in the page; `region_parts` cuts it along the handles' borders
`stage`, `markup`   camera, lights and floor; figures and legends as HTML
`controls`          setting what controls show
`guard`             errors of callbacks, shown in the page
==================  ==========================================================================
"""
