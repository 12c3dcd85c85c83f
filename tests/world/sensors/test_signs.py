import math

import numpy as np
import pytest

from twc_env.config import SignsConfig
from twc_env.world.building.floorplan import Floorplan, Sign
from twc_env.world.building.floorplan_check import validate
from twc_env.world.sensors.misreading import misread
from twc_env.world.sensors.signs import SignCamera

CLEAR = {"reader": "simple", "fragment_probability": 0.0, "character_error_probability": 0.0}
EXACT = {**CLEAR, "bearing_noise_std_rad": 0.0, "range_noise_std_m": 0.0}


def room(inner_walls=(), signs=((0.0, 5.0, 0.0),)) -> Floorplan:
    walls = [[0, 0, 10, 0], [10, 0, 10, 10], [10, 10, 0, 10], [0, 10, 0, 0], *inner_walls]
    return validate(
        Floorplan(
            "room",
            np.array(walls, float).reshape(-1, 2, 2),
            np.full(len(walls), 5.0),
            signs=[Sign(f"SIGN {i}", np.array([x, y]), facing) for i, (x, y, facing) in enumerate(signs)],
            interior_m=[[5, 5], [0.5, 5]],
        )
    )


def camera(plan=None, seed=0, **config) -> SignCamera:
    return SignCamera(SignsConfig(**{**EXACT, **config}), plan or room(), 0, seed)


def towards_sign(x: float, y: float) -> np.ndarray:
    return np.array([x, y, math.atan2(5.0 - y, -x)])


def test_a_sign_ahead_is_read_with_its_true_bearing_and_range():
    readings, sources = camera().read(np.array([3.0, 5.0, math.pi - 0.5]))
    assert sources == (0,)
    assert readings[0].text == "SIGN 0"
    assert readings[0].bearing_rad == pytest.approx(0.5)
    assert readings[0].range_m == pytest.approx(2.98)


def test_a_sign_behind_a_wall_is_not_read():
    pose = towards_sign(3.0, 5.0)
    assert camera().read(pose)[1] == (0,)
    assert camera(room([[2, 4, 2, 6]])).read(pose)[1] == ()


def test_a_sign_is_not_read_from_behind():
    plan = room([[5, 3, 5, 7]], signs=[(5.0, 5.0, 0.0)])
    assert camera(plan).read(np.array([7.0, 5.0, math.pi]))[1] == (0,)
    assert camera(plan).read(np.array([3.0, 5.0, 0.0]))[1] == ()


@pytest.mark.parametrize(
    ("settings", "near_m", "far_m"),
    [
        ({"range_max_m": 3.0}, 2.95, 3.1),
        ({"range_max_m": 8.0, "focal_length_px": 500.0, "character_height_m": 0.05, "height_min_px": 5.0}, 4.9, 5.1),
    ],
)
def test_a_sign_out_of_range_or_with_letters_too_small_from_there_is_not_read(settings, near_m, far_m):
    device = camera(**settings)
    assert device.read(towards_sign(near_m, 5.0))[1] == (0,)
    assert device.read(towards_sign(far_m, 5.0))[1] == ()


def test_a_sign_seen_too_obliquely_is_not_read():
    device = camera(incidence_max_rad=1.0)
    for angle, expected in ((0.95, (0,)), (-0.95, (0,)), (1.05, ()), (-1.05, ())):
        pose = towards_sign(0.02 + 2 * math.cos(angle), 5.0 + 2 * math.sin(angle))
        assert device.read(pose)[1] == expected


def test_a_sign_outside_the_field_of_view_is_not_read():
    device = camera(field_of_view_rad=1.0)
    for offset, expected in ((0.45, (0,)), (-0.45, (0,)), (0.55, ()), (-0.55, ()), (math.pi, ())):
        assert device.read(np.array([3.0, 5.0, math.pi + offset]))[1] == expected


def test_several_signs_are_read_at_once_with_their_own_sources():
    plan = room(signs=[(0.0, 4.0, 0.0), (0.0, 6.0, 0.0), (10.0, 5.0, math.pi)])
    readings, sources = camera(plan).read(np.array([2.5, 5.0, math.pi]))
    assert sources == (0, 1)
    assert [r.text for r in readings] == ["SIGN 0", "SIGN 1"]
    assert readings[0].bearing_rad > 0 > readings[1].bearing_rad


def test_measured_bearing_and_range_scatter_as_configured():
    device = camera(bearing_noise_std_rad=0.05, range_noise_std_m=0.1)
    readings = [device.read(np.array([3.0, 5.0, math.pi]))[0][0] for _ in range(2000)]
    assert np.std([r.bearing_rad for r in readings]) == pytest.approx(0.05, rel=0.06)
    assert np.std([r.range_m for r in readings]) == pytest.approx(0.1, rel=0.06)


def test_fragments_come_as_often_as_configured_with_10_to_45_percent_of_the_text():
    config = SignsConfig(fragment_probability=0.2, character_error_probability=0.0)
    random, text = np.random.default_rng(0), "ABCDEFGHIJKLMNOPQRST"
    readings = [misread(text, config, random) for _ in range(5000)]
    fragments = [r for r in readings if r != text]
    assert len(fragments) / 5000 == pytest.approx(0.2, abs=0.015)
    assert all(fragment in text for fragment in fragments)
    assert {len(fragment) for fragment in fragments} <= set(range(2, 10))


def test_characters_are_misread_at_the_configured_rate():
    config = SignsConfig(fragment_probability=0.0, character_error_probability=0.05)
    random, text = np.random.default_rng(1), "X" * 20
    wrong = longer = shorter = 0
    for _ in range(4000):
        reading = misread(text, config, random)
        longer += len(reading) > 20
        shorter += len(reading) < 20
        wrong += sum(character != "X" for character in reading)
    characters = 4000 * 20
    assert wrong / characters == pytest.approx(0.05 * 0.85, rel=0.06)
    assert longer / 4000 == pytest.approx(1 - (1 - 0.05 * 0.15) ** 20, abs=0.025)
    assert shorter / 4000 == pytest.approx(1 - (1 - 0.05 * 0.15) ** 20, abs=0.025)


def test_substitutions_prefer_the_similar_character():
    config = SignsConfig(fragment_probability=0.0, character_error_probability=0.2)
    random = np.random.default_rng(2)
    seen = [c for _ in range(3000) for c in misread("OOOO", config, random) if c != "O"]
    assert seen.count("0") / len(seen) > 0.5


def test_a_reading_always_has_its_source_even_when_text_is_lost():
    config = {**CLEAR, "character_error_probability": 1.0}
    plan = room()
    device = SignCamera(SignsConfig(**config), plan, 0, 0)
    for _ in range(200):
        readings, sources = device.read(np.array([3.0, 5.0, math.pi]))
        assert len(readings) == len(sources)
        assert all(r.text.strip() for r in readings)


def rate_read(config: dict, pose, previous=None, robots=None, count=300) -> float:
    """Share of correct readings, each by a new camera."""
    plan, right = room(), 0
    for seed in range(count):
        device = SignCamera(SignsConfig(**config), plan, 0, seed)
        readings, _ = device.read(np.array(pose), previous, robots)
        right += any(r.text == "SIGN 0" for r in readings)
    return right / count


def test_texts_are_read_worse_from_far_away_obliquely_and_while_turning():
    facing = math.pi
    near = rate_read({}, [1.5, 5.0, facing])
    assert near > 0.5
    assert rate_read({"range_max_m": 8.0}, [6.0, 5.0, facing]) < near - 0.2
    oblique = [2.5 * math.cos(1.0), 5.0 + 2.5 * math.sin(1.0), facing + 1.0]
    head_on, askew = (rate_read({"focal_length_px": 400.0}, pose) for pose in ([2.5, 5, facing], oblique))
    assert askew < head_on - 0.1
    turning = np.array([1.5, 5.0, facing - 0.3])
    assert rate_read({"exposure_s": 0.02}, [1.5, 5.0, facing], turning) < 0.1


def test_a_robot_in_between_occludes_the_letters_behind_it():
    pose = [3.0, 5.0, math.pi]
    hides = np.array([pose, [1.5, 5.0, 0.0]])
    beside = np.array([pose, [1.5, 6.5, 0.0]])
    assert rate_read({}, pose, None, hides, 50) == 0.0
    assert rate_read({}, pose, None, beside, 50) == rate_read({}, pose, None, None, 50) > 0.3
    assert rate_read({"robots_hide": False}, pose, None, hides, 50) > 0.3


def test_a_robot_at_the_left_of_the_view_occludes_the_beginning_of_the_text():
    config = SignsConfig(focal_length_px=3000.0, character_height_m=0.1)
    device = SignCamera(config, room(), 0, 0)
    # Facing -x, left is -y: the disc occludes the half of the sign below its centre.
    robots = np.array([[3.0, 5.0, math.pi], [1.0, 4.77, 0.0]])
    texts = {r.text for _ in range(50) for r in device.read(robots[0], None, robots)[0]}
    assert texts
    assert all("SI" not in text for text in texts)
    assert any(text.endswith("0") or text.endswith("O") for text in texts)


def test_reading_errors_of_a_sign_are_correlated_between_robots():
    config = SignsConfig(focal_length_px=380.0)
    pose, plan, again, another = np.array([3.0, 5.0, math.pi]), room(), [], []
    for seed in range(400):
        one, two = (SignCamera(config, plan, robot, seed) for robot in (0, 1))
        first, second = one.read(pose)[0], two.read(pose)[0]
        other = SignCamera(config, plan, 0, seed + 1000).read(pose)[0]
        if first and first[0].text != "SIGN 0":
            again.append(bool(second) and second[0].text == first[0].text)
            another.append(bool(other) and other[0].text == first[0].text)
    assert len(again) > 60
    assert np.mean(again) > np.mean(another) + 0.1
