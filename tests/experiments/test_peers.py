"""The comparison with other libraries, at small size."""

from __future__ import annotations

import json

from experiments.peers import Options, run, table


def test_every_installed_peer_is_measured_and_ours_is_sound(tmp_path):
    rows = run(Options(tmp_path, resolution=48, rounds=1))
    assert json.loads((tmp_path / "peers.json").read_text())["rows"] == rows
    assert (tmp_path / "peers.md").read_text().strip() == table(rows)
    ours = [row for row in rows if row["mesher"].startswith("implicit_warp")]
    assert len(ours) == 4
    for row in ours:
        assert row["watertight"]
        assert row["crossings"] == row["zero_area_faces"] == row["open_edges"] == 0
        assert row["seconds"] > 0
    canonical = {row["mesher"]: row for row in rows if row["scene"] == "canonical"}
    assert canonical["implicit_warp"]["genus"] == [5]
    assert {"scikit-image, all sampled", "Open3D, all sampled"} <= canonical.keys()
    sharp, plain = (row["volume_error"] for row in ours if row["scene"] == "twisted plate")
    assert abs(sharp) < abs(plain)
