"""Link files: defaults, shared values, round trips, and errors of one line."""

import math
import os
import time

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.engine.setup.options import Estimator
from meshtrace.errors import Refused
from meshtrace.optics import MixturePhase, Petzold, Water
from meshtrace.scenario import MeshFile, Scenario, parse_setting
from meshtrace.surfaces import (
    Cos2sSpreading,
    Elfouhaily,
    FlatSea,
    JonswapSea,
    MeasuredSea,
    SinusoidalSea,
    SpectralSea,
    TiltedPlane,
    Tma,
)


def read(text, **options):
    return Scenario.from_toml(text, **options)


def problem(text):
    with pytest.raises(Refused) as caught:
        read(text, source="link.toml")
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith("link.toml: ")
    return message.removeprefix("link.toml: ")


def test_an_empty_file_is_the_default_link_at_5_metres_per_second():
    scenario = read("")
    assert scenario.link == mt.Link(
        bubbles=mt.HallNovarini(wind_speed=5.0), whitecaps=mt.Whitecaps(wind_speed=5.0)
    )
    assert scenario.surface == JonswapSea(wind_speed=5.0)
    assert scenario.run.photons == scenario.run.estimator.default_photons


def test_one_wind_speed_drives_sea_bubbles_and_whitecaps():
    scenario = read("wind_speed = 13.0")
    assert scenario.surface.wind_speed == 13.0
    assert scenario.link.bubbles.wind_speed == 13.0
    assert scenario.link.whitecaps.wind_speed == 13.0


def test_a_part_may_have_a_wind_speed_of_its_own():
    text = "wind_speed = 13.0\nwhitecaps = { wind_speed = 3.0 }\n[sea]\nwind_speed = 8.0"
    scenario = read(f"{text}\n[bubbles]\nwind_speed = 7.0")
    assert scenario.surface.wind_speed == 8.0
    assert scenario.link.bubbles.wind_speed == 7.0
    assert scenario.link.whitecaps.wind_speed == 3.0


@pytest.mark.parametrize(
    "sea",
    ["", "fetch = 1e4", 'spectrum = "elfouhaily"', 'spectrum = { kind = "tma", depth = 9.0 }'],
)
def test_no_wind_is_a_flat_sea_without_bubbles_and_foam(sea):
    scenario = read(f"wind_speed = 0\n[sea]\n{sea}\n[bubbles]\ndepth = 'clamped'")
    assert scenario.surface == FlatSea()
    assert scenario.link.bubbles is None
    assert scenario.link.whitecaps is None


def test_no_wind_leaves_surfaces_that_need_none():
    text = 'wind_speed = 0\n[sea]\nspectrum = "sinusoid"\namplitude = 0.1\nwavelength = 2.0'
    assert read(text).surface == SinusoidalSea(amplitude=0.1, wavelength=2.0)


def test_paper_sets_every_printed_form():
    link = read('physics = "paper"').link
    assert link.physics == mt.Physics.paper()
    assert link.water.phase == mt.FournierForand(cdf_coef="paper")
    assert (link.bubbles.psi, link.bubbles.q, link.bubbles.depth) == ("paper", 2.0, "mean_level")
    assert link.whitecaps.model == "paper_0255"


def test_paper_leaves_what_is_given():
    text = 'physics = "paper"\nwhitecaps = "monahan80"\n[bubbles]\nq = "mie"\n[water.phase]\n'
    link = read(f'{text}model = "fournier-forand"\ncdf_coef = "exact"').link
    assert link.water.phase.cdf_coef == "exact"
    assert (link.bubbles.q, link.bubbles.psi) == ("mie", "paper")
    assert link.whitecaps.model == "monahan80"


def test_single_switches_are_a_table():
    assert read('physics = { snell = "paper" }').link.physics == mt.Physics(snell="paper")


@pytest.mark.parametrize(
    ("toml", "surface"),
    [
        ('spectrum = "flat"\nheight = 0.1', FlatSea(height=0.1)),
        ('spectrum = "plane"\nslope_x = 0.2', TiltedPlane(slope_x=0.2)),
        ('spreading = "cos2s"\nseed = 3', JonswapSea(spreading=Cos2sSpreading(), seed=3)),
        ("spreading = { kind = 'cos2s', s = 4.0 }", JonswapSea(spreading=Cos2sSpreading(s=4.0))),
        ("fetch = 1e4\nomega_max = 6.0", JonswapSea(fetch=1e4, omega_max=6.0)),
        (
            'spectrum = "elfouhaily"\nfetch = 1e4\nomega_max = 9.0',
            SpectralSea(spectrum=Elfouhaily(wind_speed=5.0, fetch=1e4), omega_max=9.0),
        ),
        (
            'spectrum = "tma"\ndepth = 9.0\nwind_speed = 7.0',
            SpectralSea(spectrum=Tma(wind_speed=7.0, depth=9.0)),
        ),
        (
            'spectrum = { kind = "tma", depth = 9.0 }\ncapillary = false',
            SpectralSea(spectrum=Tma(wind_speed=5.0, depth=9.0), capillary=False),
        ),
        (
            'spectrum = "measured"\nomega = [1.0]\ntheta = [0.0]\nvariance = [[0.02]]',
            MeasuredSea(omega=(1.0,), theta=(0.0,), variance=((0.02,),)),
        ),
    ],
)
def test_surfaces_by_name(toml, surface):
    assert read(f"[sea]\n{toml}").surface == surface


def test_time_extent_and_spacing_belong_to_the_mesh():
    scenario = read('[sea]\nspectrum = "flat"\ntime = 2.0\nextent = 3.0\nspacing = 0.5')
    assert scenario.meshing == mt.Meshing(time=2.0, extent=3.0, spacing=0.5)
    assert len(scenario.mesh().vertices) == 13**2


def test_a_tabulated_spectrum_is_read_from_a_file_beside_the_link_file(tmp_path):
    (tmp_path / "waves.csv").write_text("omega,S\n1.0,0.0\n2.0,0.1\n3.0,0.0\n")
    (tmp_path / "link.toml").write_text('[sea]\nspectrum = "tabulated"\nfile = "waves.csv"')
    spectrum = Scenario.load(tmp_path / "link.toml").surface.spectrum
    assert (spectrum.omega, spectrum.density) == ((1.0, 2.0, 3.0), (0.0, 0.1, 0.0))
    for text, message in (
        ("", "sea.omega: missing, allowed: frequencies [rad s-1] beside density, or file"),
        ("file = ['waves.csv']", "sea.file: ['waves.csv'], allowed: the path of a text file"),
    ):
        with pytest.raises(Refused) as refused:
            read(f'[sea]\nspectrum = "tabulated"\n{text}')
        assert str(refused.value) == message


def test_water_types_are_taken_at_the_wavelength_of_the_transmitter():
    text = '[water]\ntype = "jerlov-IB"\nb = 0.2\n[transmitter]\nwavelength_nm = 500.0'
    water = read(text).link.water
    assert water == Water.from_type("jerlov-IB", 500.0, b=0.2)


def test_a_water_type_follows_the_transmitter_and_round_trips():
    text = '[water]\ntype = "jerlov-IB"\nn = 1.34\n[transmitter]\nwavelength_nm = 500.0'
    scenario = read(text)
    table = scenario.to_config()["water"]
    assert table == {"type": "jerlov-IB", "n": 1.34, "bottom_albedo": 0.0}
    assert Scenario.from_toml(scenario.to_toml()) == scenario
    green = Scenario.from_config({**scenario.to_config(), "transmitter": {"wavelength_nm": 550.0}})
    assert green.link.water == scenario.link.water.at_wavelength(550.0)
    assert green.link.water == scenario.link.at_wavelength(550.0).water
    apart = scenario.replace("link.transmitter.wavelength_nm", 550.0)  # the water stays
    assert Scenario.from_toml(apart.to_toml()).link.water.c == scenario.link.water.c


def test_waters_by_constituents_round_trip_and_refuse_contradictions():
    text = "[water]\nchlorophyll = [[0, 0.2], [20, 0.8]]\ncdom = 0.05\nbottom_depth = 90.0"
    scenario = read(f"wind_speed = 0.0\n{text}\n[transmitter]\nwavelength_nm = 532.0")
    water = scenario.link.water
    assert water.layers[0][1:] == (water.a, water.b)
    assert water.spectrum.cdom == 0.05
    assert Scenario.from_toml(scenario.to_toml(notes=True)) == scenario
    assert "a" not in scenario.to_config()["water"]
    again = mt.Link.model_validate(scenario.link.model_dump(mode="json"))  # as in a result
    assert again == scenario.link
    for line, message in (
        ("a = 0.1\nb = 0.2", "water.chlorophyll: .* without a and b, or layers"),
        ("layers = [[0, 0.1, 0.2]]", "water.chlorophyll: .* without a and b, or layers"),
        ('type = "jerlov-II"', "water.chlorophyll: .* no such key"),
        ("table = [[400, 0.1, 0.2]]", "water.chlorophyll: .* no such key"),
    ):
        with pytest.raises(Refused, match=f"^{message}"):
            read(f"[water]\nchlorophyll = 0.2\n{line}")


def test_a_water_type_is_refused_where_it_was_not_measured():
    blue = '[water]\ntype = "coastal"\n{}\n[transmitter]\nwavelength_nm = 450.0'
    with pytest.raises(Refused, match=r"^transmitter.wavelength_nm: 450.0, allowed: 476.5 to 551"):
        read(blue.format(""))
    given = read(blue.format("a = 0.179\nb = 0.219")).link.water
    assert given == Water(a=0.179, b=0.219, phase=Petzold(water="coastal"))


@pytest.mark.filterwarnings("ignore::meshtrace.engine.outcome.FewSamplesWarning")
def test_gains_bits_and_maps_state_the_water_and_its_source():
    scenario = read("wind_speed = 0.0\n[water]\ntype = 'jerlov-IB'")
    line = "a 0.0227, b 0.0644 m-1 at 470 nm: jerlov-IB (Solonenko and Mobley 2015)"
    found = (
        mt.simulate(scenario, photons=32),
        mt.link_performance(scenario, photons=32),
        mt.coverage_map(scenario, extent=1.0, step=1.0, photons=32),
    )
    for result in found:
        assert any(text.endswith(line) for text in result.summary().splitlines())


def test_a_water_type_gives_its_phase_function_to_layers():
    water = read('[water]\ntype = "petzold-harbour"\nlayers = [[0, 0.1, 0.2], [5, 0.1, 0.4]]').link
    assert water.water.phase == Petzold(water="harbour")
    assert water.water.a == 0.1


def test_phase_functions_nest():
    text = "[water.phase]\nmodel = 'mixture'\ncomponents = ['petzold', { model = 'rayleigh' }]\n"
    phase = read(f"{text}weights = [3, 1]").link.water.phase
    assert isinstance(phase, MixturePhase)
    assert [part.kind for part in phase.components] == ["petzold", "rayleigh"]


def test_bubbles_share_the_water_and_the_wavelength():
    bubbles = read("[water]\nn = 1.34\n[transmitter]\nwavelength_nm = 520.0").link.bubbles
    assert (bubbles.n_water, bubbles.wavelength_nm) == (1.34, 520.0)


@pytest.mark.parametrize("text", ["bubbles = 'none'", "[bubbles]\nmodel = 'none'"])
def test_bubbles_can_be_left_out(text):
    assert read(text).link.bubbles is None


def test_lists_of_transmitters_and_receivers():
    text = "[[transmitter]]\nkind = 'sun'\n[[receiver]]\n[[receiver]]\nkind = 'water-aperture'"
    link = read(text).link
    assert link.transmitter == (mt.Sun(),)
    assert link.receiver == (mt.Receiver(), mt.WaterAperture())


FILES = [
    "",
    "wind_speed = 13",
    "wind_speed = 0",
    "wind_speed = 20.5\nwhitecaps = 'none'",
    "whitecaps = { wind_speed = 3.0 }",
    'physics = "paper"',
    'physics = "paper"\nwind_speed = 13.0\n[bubbles]\nq = "mie"\nwind_speed = 7.0',
    '[physics]\nsnell = "paper"',
    '[sea]\nspectrum = "elfouhaily"\nfetch = 1e4\nspreading = "elfouhaily"\ntime = 3.0',
    '[sea.spectrum]\nkind = "tma"\ndepth = 12.0',
    '[sea]\nspectrum = "measured"\nomega = [1]\ntheta = [0]\nvariance = [[0.1]]\nseed = 4',
    '[water]\ntype = "jerlov-II"\nbottom_depth = 40.0\n[water.phase]\nmodel = "petzold"',
    "[water]\nlayers = [[0, 0.1, 0.2], [3, 0.3, 0.2]]\n[planes]\ndepths = [1, 2]\nn_cosines = 4",
    "[[receiver]]\n[[receiver]]\nkind = 'water-aperture'\n[[transmitter]]\nkind = 'sun'",
    "receiver = []\n[planes]\ndepths = [1.0]",
    "[run]\nphotons = 1e6\nseed = 18446744073709551615\nnormals = 'facet'\nestimator = 'analog'\nroulette = 0.01",
    "[water.phase]\nmodel = 'histogram'\n"
    f"theta_edges = [0.0, 1.0, {math.pi!r}]\ncdf = [0.0, 0.5, 1.0]",
]


@pytest.mark.parametrize("text", FILES)
def test_the_full_configuration_loads_back(text):
    scenario = read(text)
    assert read(scenario.to_toml()) == scenario
    assert Scenario.from_config(scenario.to_config()) == scenario


def test_a_written_file_still_follows_its_wind_speed():
    config = read("wind_speed = 13.0").to_config()
    assert Scenario.from_config({**config, "wind_speed": 8.0}) == read("wind_speed = 8.0")


@pytest.mark.parametrize(
    "text",
    [
        "wind_speed = 8.0\n[sea]\nseed = 3\ntime = 1.5\nspacing = 0.5",
        'physics = "paper"\n[sea]\nspectrum = "flat"\nextent = 40.0',
        "[[receiver]]\n[[receiver]]\nheight = 2.0",
        "[run]\nestimator = 'analog'\nnormals = 'facet'\nroulette = 0.001\nmax_events = 50",
    ],
)
def test_a_result_holds_its_scenario(text, tmp_path):
    scenario = read(text, changes={"run.photons": 5000, "run.threads": 1})
    result = scenario.simulate()
    result.save(tmp_path / "result.nc")
    loaded = mt.GainResult.load(tmp_path / "result.nc")
    expected = read(text, changes={"run.photons": 5000})
    assert Scenario.from_provenance(loaded.provenance) == expected


def test_a_result_of_a_script_gives_a_scenario():
    link = mt.Link(bubbles=mt.HallNovarini(wind_speed=7.0, psi="paper", q=2.0))
    result = mt.simulate(link, FlatSea(), photons=1000)
    scenario = Scenario.from_provenance(result.provenance)
    assert (scenario.link, scenario.surface, scenario.wind_speed) == (link, FlatSea(), 7.0)
    assert read(scenario.to_toml()) == scenario


@pytest.mark.parametrize(
    ("text", "estimator"),
    [
        ("", "forced"),
        ("physics = 'paper'", "analog"),
        ("physics = 'paper'\nwind_speed = 0", "forced"),
        ("transmitter.kind = 'sun'", "analog"),
        ("receiver = []\n[planes]\ndepths = [1.0]", "analog"),
    ],
)
def test_the_default_estimator_can_follow_the_link(text, estimator):
    scenario = read(text, changes={"run.photons": 300})
    assert scenario.run.estimator.kind == estimator
    assert scenario.simulate().provenance["run"]["estimator"] == estimator


def test_each_estimator_has_its_number_of_photons():
    for kind, estimator in Estimator.registered.items():
        assert read(f"run.estimator = '{kind}'").run.photons == estimator.default_photons


def test_a_run_is_what_simulate_gives():
    scenario = read("[run]\nphotons = 20000\nseed = 5")
    direct = mt.simulate(scenario.link, scenario.surface, photons=20_000, seed=5)
    assert (scenario.simulate().gain, scenario.run.photons) == (direct.gain, 20_000)


@pytest.fixture
def mesh_file(tmp_path):
    FlatSea(height=0.05).mesh(extent=30.0, spacing=1.0).to_trimesh().export(tmp_path / "own.ply")
    return tmp_path


def test_a_mesh_file_is_looked_for_beside_the_link_file(mesh_file):
    (mesh_file / "link.toml").write_text('[sea]\nmesh = "own.ply"\n[run]\nphotons = 2000')
    scenario = Scenario.load(mesh_file / "link.toml")
    assert scenario.surface == MeshFile(file=str((mesh_file / "own.ply").resolve()))
    np.testing.assert_allclose(scenario.mesh().vertices[:, 2], 0.05, rtol=1e-6)
    assert Scenario.from_provenance(scenario.simulate().provenance) == scenario
    assert read(scenario.to_toml()) == scenario


@pytest.mark.parametrize(
    ("link", "words"),
    [
        ("[receiver]\nposition = [40.0, 0.0]", ["mesh: ", "covers", "-30..30"]),
        ("[sea]\nextent = 31.0", ["sea.mesh", "31.0 m", "covers"]),
        ("[transmitter]\ndepth = 0.01\n[sea]\nmesh='deep.ply'", ["transmitter.depth", "0.01"]),
    ],
)
def test_a_mesh_that_does_not_suit_the_link_is_refused(mesh_file, link, words):
    FlatSea(height=-0.05).mesh(extent=30.0, spacing=1.0).to_trimesh().export(mesh_file / "deep.ply")
    config = {"sea.mesh": "own.ply"} if "deep" not in link else {}
    scenario = read(link, folder=mesh_file, changes=config)
    with pytest.raises(Refused) as caught:
        scenario.mesh()
    assert "\n" not in str(caught.value)
    assert all(word in str(caught.value) for word in [*words, "allowed: "])


@pytest.mark.parametrize("content", [b"", b"ply\nnonsense\n", b"\x00\xff\x00"])
def test_a_file_that_is_no_mesh_is_refused(tmp_path, content):
    (tmp_path / "own.ply").write_bytes(content)
    scenario = read('[sea]\nmesh = "own.ply"', folder=tmp_path)
    with pytest.raises(Refused, match=r"^sea\.mesh: '.*own\.ply': .*allowed: ") as caught:
        scenario.mesh()
    assert "\n" not in str(caught.value)


def test_a_mesh_without_file_cannot_be_loaded_back():
    result = mt.simulate(mt.Link(), FlatSea().mesh(extent=60.0, spacing=5.0), photons=32)
    with pytest.raises(Refused, match="surface: 'mesh', allowed: "):
        Scenario.from_provenance(result.provenance)


@pytest.mark.parametrize(
    ("text", "path", "value", "allowed"),
    [
        ("[transmitter]\ndepth = -3.0", "transmitter.depth", "-3.0", "0 < depth <= 12000"),
        ("[receiver]\nheight = -1", "receiver.height", "-1", "> 0"),
        ("[receiver]\nfov_deg = 181", "receiver.fov_deg", "181", "0 < fov_deg <= 180"),
        ("[receiver]\nfov_deg = nan", "receiver.fov_deg", "nan", "finite numbers"),
        ("[water]\na = -inf", "water.a", "-inf", "finite numbers"),
        ("[water]\na = '0.1'", "water.a", "'0.1'", "numbers without quotes"),
        ("[water]\na = true", "water.a", "true", "neither true nor false"),
        ("[water]\na = 1979-05-27", "water.a", "datetime", "a number"),
        ("water = 3", "water", "3", "a table"),
        ("wind_speed = -3.0", "wind_speed", "-3.0", "0 <= wind_speed <= 60 m/s"),
        ("wind_speed = 40.0", "whitecaps.wind_speed", "40.0", "0 <= wind_speed <= 30"),
        ("[run]\nphotons = 0", "run.photons", "0", "1 <= photons"),
        ("[run]\nphotons = 1.5", "run.photons", "1.5", "an integer"),
        ("[run]\nestimator = 'guess'", "run.estimator", "'guess'", ", ".join(Estimator.registered)),
        ("[run]\nseed = 1" + 30 * "0", "run.seed", "1000", "integers of 64 bits"),
        ("[sea]\nspacing = 0", "sea.spacing", "0", "> 0"),
        ("[sea]\nfetch = -1", "sea.fetch", "-1", "0 < fetch < inf m"),
        ("[sea]\nomega_max = 1.0", "sea.omega_max", "1.0", "> 1.175 rad/s"),
        ("[sea]\nspreading = 'cos3'", "sea.spreading.kind", "'cos3'", "ittc, cos2s"),
        ("[sea]\nspectrum = 'sinusoid'", "sea.amplitude", "missing", "a value"),
        ("[sea]\nmesh = 'none.ply'", "sea.mesh", "'none.ply'", "an STL, PLY or OBJ file"),
        ("[sea]\nmesh = 'a.ply'\nseed = 1", "sea.seed", "1", "beside mesh only extent"),
        ("wind_speed = 7\n[sea]\nwaves = 'paper'", "sea.waves", "'paper'", "at 5 and 13 m/s only"),
        ("[water]\ntype = 'jerlov-X'", "water.type", "'jerlov-X'", "jerlov-IB"),
        (
            "[water]\ntype = 'jerlov-IB'\n[transmitter]\nwavelength_nm = 800",
            "transmitter.wavelength_nm",
            "800.0",
            "300 <= wavelength_nm <= 700 nm",
        ),
        ("[water]\nlayers = [[0, 1]]", "water.layers", "[[0, 1]]", "rows of [depth, a, b]"),
        ("[water]\nbottom_depth = 3", "transmitter.depth", "10 m", "less than water.bottom_depth"),
        ("[water]\nphase.g = 3", "water.phase.g", "3", "mu"),
        ("water.phase = 'hg'", "water.phase.kind", "'hg'", "henyey-greenstein"),
        ("physics = 'papr'", "physics", "'papr'", "physical, paper"),
        ("physics = 1", "physics", "1", "a table"),
        ("transmitter = []", "transmitter", "()", "at least one source"),
        ("transmitter.kind = 'lde'", "transmitter.kind", "'lde'", "led, gaussian-beam"),
        ("[[receiver]]\n[[receiver]]\nradius = 0", "receiver[1].radius", "0", "> 0"),
        ("[receiver]\nposition = [1, 'a']", "receiver.position[1]", "'a'", "a number"),
        ("[bubbles]\nq = 'mi'", "bubbles.q", "'mi'", '"mie" or 0 < q <= 10'),
        ("bubbles = 'none'\n[sea]\nx = 1", "sea.x", "1", "spectrum"),
        ("whitecaps = 'w_0255'", "whitecaps.model", "'w_0255'", "w_0225"),
        ("[planes]\ndepths = [2, 1]", "planes.depths", "(2.0, 1.0)", "strictly rising"),
        ("n_air = 0.5", "n_air", "0.5", "1 <= n_air <= 2"),
        ("n_air = true", "n_air", "true", "neither true nor false"),
    ],
)
def test_errors_name_field_value_and_what_is_allowed(text, path, value, allowed):
    message = problem(text)
    assert message.startswith(f"{path}: ")
    assert value in message.partition("allowed: ")[0]
    assert allowed in message.partition("allowed: ")[2]


@pytest.mark.parametrize(
    ("text", "path", "near"),
    [
        ("recevier = {}", "recevier", "receiver"),
        ("[transmitter]\ndepht = 3.0", "transmitter.depht", "depth"),
        ("[sea]\nfetsh = 3.0", "sea.fetsh", "fetch"),
        ("[sea]\nspectrum = 'elfouhaily'\nfetsh = 3.0", "sea.fetsh", "fetch"),
        ("wind_speed = 0\n[sea]\nfetsh = 3.0", "sea.fetsh", "fetch"),
        ("[water.phase]\nmuu = 3.0", "water.phase.muu", "mu"),
        ("[run]\nphoton = 3", "run.photon", "photons"),
        ("[bubbles]\nmodel = 'none'\ndeptth = 'local'", "bubbles.deptth", "depth"),
        ("[physics]\nsnel = 'paper'", "physics.snel", "snell"),
    ],
)
def test_unknown_keys_name_the_nearest(text, path, near):
    message = problem(text)
    assert message.startswith(f"{path}: ")
    assert f"no such key, did you mean {near}" in message


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("depth = 3.0", "transmitter.depth or bubbles.depth"),
        ("[receiver]\ndepth = 3.0", "transmitter.depth or bubbles.depth"),
        ("[transmitter]\nheight = 3.0", "receiver.height"),
        ("[water.phase]\nchlorophyll = 3.0", "water.chlorophyll"),
        ("[water]\nspectrm = 3", "sea.spectrum"),
    ],
)
def test_unknown_keys_name_those_of_other_tables(text, meant):
    assert f", no such key, did you mean {meant}? allowed: " in problem(text)


@pytest.mark.parametrize("build", [mt.Link, mt.Link().replace])
def test_unknown_fields_name_those_of_parts(build):
    with pytest.raises(
        Refused, match=r"^depth: 3\.0, no such key, did you mean transmitter\.depth\?"
    ):
        build(depth=3.0)


def test_bad_toml_names_the_line():
    assert "(at line 2, column 5)" in problem("wind_speed = 5.0\n[sea\n")


@pytest.mark.parametrize("depth", [200, 5000])
def test_deep_nesting_is_one_line(depth):
    assert "allowed: " in problem(f"wind_speed = {depth * '['}{depth * ']'}")


def test_strange_keys_and_long_values_stay_on_one_short_line():
    assert problem('"a\\nb" = 1').startswith(r"'a\nb': 1, no such key")
    assert len(problem(f"physics = '{'x' * 10_000}'")) < 200


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(Refused, match=r"none\.toml: No such file or directory, allowed: "):
        Scenario.load(tmp_path / "none.toml")
    (tmp_path / "latin.toml").write_bytes(b"# \xe9")
    with pytest.raises(Refused, match=r"latin\.toml: .*allowed: a TOML file in UTF-8"):
        Scenario.load(tmp_path / "latin.toml")


def test_the_mark_of_some_editors_is_no_text(tmp_path):
    """A byte-order mark once was an invalid statement."""
    (tmp_path / "a.toml").write_text("wind_speed = 7.0\r\n", encoding="utf-8-sig", newline="")
    assert Scenario.load(tmp_path / "a.toml").wind_speed == 7.0


@pytest.mark.parametrize(
    ("text", "path"),
    [
        ("[sea]\nspacing = 0.001", "mesh"),
        ("[sea]\nextent = 1e6", "mesh"),
        ("[sea]\nspectrum = 'flat'\nextent = 1000\nspacing = 0.5", "mesh"),
        (
            "[sea.waves]\nomega_min = 1.0\nomega_max = 60.0\nd_omega = 0.001\nd_theta = 0.1",
            "sea.waves",
        ),
        (
            "[transmitter]\ndepth = 0.2\n[sea]\nspectrum = 'flat'\nheight = -0.3",
            "transmitter.depth",
        ),
        ("[receiver]\nheight = 0.2\n[sea]\nspectrum = 'flat'\nheight = 0.3", "receiver.height"),
        ("transmitter.kind = 'sun'\nrun.estimator = 'forced'", "transmitter"),
        ("receiver.kind = 'water-aperture'\nrun.estimator = 'forced'", "receiver"),
        ("run.estimator = 'forced'\n[planes]\ndepths = [1.0]", "planes"),
        ("run.estimator = 'forced'\n[transmitter]\nkind = 'sun'", "transmitter"),
    ],
)
def test_surfaces_that_do_not_suit_are_refused_before_the_run(text, path):
    with pytest.raises(Refused) as caught:
        read(text).simulate()
    assert str(caught.value).startswith(f"{path}: ")
    assert "allowed: " in str(caught.value)


def test_settings_are_read_as_toml_or_else_as_words():
    settings = ["a.b=20", "c = 'x'", "d=flat", "e=[1, 2]", "f=true"]
    values = [("a.b", 20), ("c", "x"), ("d", "flat"), ("e", [1, 2]), ("f", True)]
    assert [parse_setting(setting) for setting in settings] == values
    for wrong in ("depth", "=3"):
        with pytest.raises(Refused, match="allowed: key=value"):
            parse_setting(wrong)


def test_changes_replace_values_and_make_tables():
    scenario = read("[sea]\nseed = 1", changes={"sea.seed": 2, "water.phase.mu": 3.6})
    assert scenario.surface.seed == 2
    assert scenario.link.water.phase.mu == 3.6
    with pytest.raises(Refused, match=r"^wind_speed\.x: 1, allowed: a key in a table"):
        read("wind_speed = 5", changes={"wind_speed.x": 1})


def test_a_scenario_takes_surfaces_only():
    scenario = read("")
    with pytest.raises(ValueError, match="surface: int, allowed: a sea"):
        Scenario.model_validate({**dict(scenario), "surface": 3})


@pytest.mark.posix
def test_endless_and_huge_inputs_are_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "pipe.toml")
    (tmp_path / "huge.toml").write_bytes(b"#" * (17 * 2**20))
    started = time.perf_counter()
    for path in ("/dev/zero", tmp_path / "pipe.toml", tmp_path, tmp_path / "huge.toml"):
        with pytest.raises(Refused, match=r"(regular file|MB), allowed: "):
            Scenario.load(path)
    for text in ("." * 200_000, "a." * 20_000 + "a = 1", "[" + "a." * 5000 + "a]",
                 "a = " + "[" * 1000 + "]" * 1000, "a = 1" + "0" * 5000, "a=" + "{a=" * 1000):  # fmt: skip
        assert "allowed: " in problem(text)
    assert time.perf_counter() - started < 20.0
