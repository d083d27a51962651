"""The motion of a whole wall: its jumps, milestones, strains as a camera sees them, pictures and files."""

from __future__ import annotations

import meshio
import numpy as np
import pytest
from PIL import Image

import structid as si
from structid.models.masonry.displacement_field import DisplacementField, von_mises_strain

JOINTS = dict(normal_energy=3e3, normal_strength=0.95e6, tangential_energy=2e5, tangential_strength=0.6e6)
RECORD = si.GroundMotion.synthetic(seed=8).lowpass(20.0).trim(6.0, 8.5).scale_to_pga(6.0)


@pytest.fixture(scope="module")
def wall():
    return si.MasonryWall(**JOINTS, channels=("drift", "largest_opening", "largest_slip", "largest_penetration"))


@pytest.fixture(scope="module")
def film(wall):
    return wall.film(RECORD)


@pytest.mark.slow
def test_the_film_is_the_run(wall, film):
    found = wall.simulate(np.zeros((1, 0)), RECORD)
    # Other channels are other code, which may round otherwise.
    np.testing.assert_allclose(film.drift, found.channel("drift")[0], rtol=1e-10, atol=1e-16)
    jumps = film.jumps
    for channel, expected in (
        ("largest_opening", jumps[..., 0].max(axis=1)),
        ("largest_slip", np.abs(jumps[..., 1]).max(axis=1)),
        ("largest_penetration", -jumps[..., 0].min(axis=1)),
    ):
        np.testing.assert_allclose(found.channel(channel)[0], expected, rtol=1e-8, atol=1e-12)
    top = film.since_rest[:, film.mesh.corner("top_left"), 0]
    np.testing.assert_allclose(top, film.drift, atol=1e-15)
    assert (film.displacements[:, film.mesh.fixed] == 0.0).all()


def test_a_wall_on_joints_has_them_open_from_the_ground():
    wall = si.MasonryWall(**JOINTS, base_joint=True, channels=("largest_opening",))
    record = RECORD.trim(0.0, 0.4)
    opening = wall.film(record).jumps[..., 0].max(axis=1)
    np.testing.assert_allclose(
        wall.simulate(np.zeros((1, 0)), record).channel("largest_opening")[0], opening, rtol=1e-8
    )


def test_milestones_are_the_largest_excursions_and_change_sides(film):
    chosen = film.milestones()
    assert len(chosen) == 5 and chosen == sorted(chosen)
    assert np.abs(film.drift).argmax() in chosen
    for i in chosen[:-1]:
        near = np.abs(film.drift[max(i - 3, 0) : i + 4])
        assert np.abs(film.drift[i]) == near.max()
    assert film.milestones(2) == sorted(film.milestones(2)) and len(film.milestones(2)) == 2


def grid_of(u_x, u_y):
    x, y = np.linspace(0.0, 1.0, 21), np.linspace(0.0, 2.0, 31)
    at = np.meshgrid(x, y)
    return DisplacementField(np.zeros(1), x, y, u_x(*at)[None], u_y(*at)[None])


def test_strains_of_uniform_fields_are_exact():
    stretched = grid_of(lambda x, y: 2e-3 * x, lambda x, y: -4e-4 * y)
    np.testing.assert_allclose(stretched.von_mises(0), np.sqrt(4e-6 + 8e-7 + 1.6e-7), rtol=1e-9)
    sheared = grid_of(lambda x, y: 1e-3 * y, lambda x, y: 0.0 * x)
    np.testing.assert_allclose(sheared.von_mises(0), np.sqrt(0.75) * 1e-3, rtol=1e-9)
    turned = grid_of(lambda x, y: -1e-3 * y + 5.0, lambda x, y: 1e-3 * x)
    np.testing.assert_allclose(turned.von_mises(0), 0.0, atol=1e-12)


def test_von_mises_strain_does_not_depend_on_the_axes():
    rng = np.random.default_rng(1)
    x, y, shear = rng.normal(size=(3, 50))
    c, s = np.cos(0.7), np.sin(0.7)
    turned = (
        c * c * x + s * s * y + c * s * shear,
        s * s * x + c * c * y - c * s * shear,
        2.0 * c * s * (y - x) + (c * c - s * s) * shear,
    )
    np.testing.assert_allclose(von_mises_strain(*turned), von_mises_strain(x, y, shear), rtol=1e-12)


def test_a_camera_sees_the_blocks_and_the_jumps(film):
    """On a grid, a block's own strains, and across a joint its jump over the grid's step."""
    instant = film.milestones()[-1]
    seen = film.displacement_field([instant], step=0.05)
    door = np.isnan(seen.ux[0])
    x, y = np.meshgrid(seen.x, seen.y)
    np.testing.assert_array_equal(door, (x > 1.2) & (x < 2.1) & (y < 1.6))
    strains = seen.von_mises(0)
    # The first bed joint of the left bay is between 0.375 and 0.425 m; joint 0 is at its left end, joint 1 at its right one.
    row = int(np.searchsorted(seen.y, 0.4)) - 1
    slips = film.jumps[instant, :2, 1] - film.jumps[0, :2, 1]
    column = 11  # between 0.575 and 0.625 m, the middle of the bay
    assert strains[row, column] == pytest.approx(np.sqrt(0.75) * abs(slips.mean()) / 0.05, rel=0.02)
    assert np.nanmedian(strains) < 0.02 * strains[row, column]


def test_fields_are_read_from_tables_and_hdf5(tmp_path, film):
    import h5py

    seen = film.displacement_field(step=0.2)
    known = ~np.isnan(seen.ux)
    t, y, x = np.meshgrid(seen.time, seen.y, seen.x, indexing="ij")
    rows = np.column_stack([a[known] for a in (t, x, y, seen.ux, seen.uy)])
    rows[:, 1:] *= 1e3
    table = tmp_path / "field.csv"
    np.savetxt(table, rows, delimiter=",", header="time,x,y,ux,uy", comments="")
    with h5py.File(tmp_path / "field.h5", "w") as store:
        for name in ("time", "x", "y", "ux", "uy"):
            store[name] = getattr(seen, name)
    for again in (DisplacementField.read(table, "mm"), DisplacementField.read(tmp_path / "field.h5")):
        np.testing.assert_allclose(again.ux, seen.ux, rtol=1e-12)
        np.testing.assert_allclose(again.y, seen.y, rtol=1e-12)
        np.testing.assert_allclose(again.von_mises(1), seen.von_mises(1), rtol=1e-7)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("x,y,ux\n0,0,0\n", "no uy"),
        ("x,y,ux,uy\n0,0,0,0\n1,0,0,0\n0,1,0,0\n0,0,1,1\n", "given twice"),
        ("x,y,ux,uy\n0,0,a,0\n", "numbers separated"),
        ("x,y,ux,uy\n0,0,0\n", "different lengths"),
        ("x,y,ux,uy\n0,0,0,0\n1,0,0,0\n", "1 rows and 2 columns"),
    ],
)
def test_a_field_that_is_none_is_told(tmp_path, text, told):
    path = tmp_path / "field.csv"
    path.write_text(text)
    with pytest.raises(si.InputError, match=told):
        DisplacementField.read(path)


def test_no_file_and_another_unit(tmp_path):
    with pytest.raises(si.InputError, match="no such file"):
        DisplacementField.read(tmp_path / "none.csv")
    (tmp_path / "f.csv").write_text("x,y,ux,uy\n0,0,0,0\n1,0,0,0\n0,1,0,0\n1,1,1,1\n")
    with pytest.raises(si.InputError, match="length_unit"):
        DisplacementField.read(tmp_path / "f.csv", "kN")


def test_pictures_and_files(tmp_path, wall, film):
    for draw, name in ((wall.plot, "mesh"), (film.plot, "deformed"), (film.plot_strains, "strains")):
        draw(save=tmp_path / name)
        assert (tmp_path / f"{name}.png").is_file() and (tmp_path / f"{name}.pdf").is_file()
    moving = film.animate(tmp_path / "wall.gif", frames=5)
    with Image.open(moving) as image:
        assert image.n_frames == 5
    with pytest.raises(si.InputError, match=r"\.gif or \.mp4"):
        film.animate(tmp_path / "wall.avi")
    collection = film.to_vtu(tmp_path / "vtu", [0, 50])
    assert collection.read_text().count("<DataSet") == 2
    read = meshio.read(tmp_path / "vtu" / "wall_0001.vtu")
    nodes = len(film.mesh.nodes)
    np.testing.assert_allclose(read.point_data["displacement"][:nodes, :2], film.since_rest[50], rtol=1e-12)
    assert len(read.cells_dict["quad"]) == 15 and len(read.cells_dict["vertex"]) == 34
    opening = read.cell_data_dict["joint opening"]["vertex"]
    np.testing.assert_allclose(opening, film.jumps[50, :, 0], rtol=1e-12)
    assert (read.cell_data_dict["von Mises strain"]["quad"] > 0.0).all()


def test_a_film_without_ffmpeg(tmp_path, film, monkeypatch):
    monkeypatch.setattr("shutil.which", lambda _name: None)
    with pytest.raises(si.InputError, match="ffmpeg"):
        film.animate(tmp_path / "wall.mp4")


def test_a_wall_that_does_not_stand_has_no_film(wall, monkeypatch):
    def none_begins(model, theta, excitation):
        nothing = np.full((1, len(excitation), len(model.channels)), np.nan)
        reason = "no equilibrium was found under the vertical load"
        return si.Histories(nothing, excitation.dt, model.channels, np.array([1]), np.zeros(1), reasons=(reason,))

    monkeypatch.setattr(si.MasonryWall, "simulate", none_begins)
    with pytest.raises(si.InputError, match="the run failed: no equilibrium"):
        wall.film(RECORD)
