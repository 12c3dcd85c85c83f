"""What a user should know of settings that are valid, but do less together than each says."""

from __future__ import annotations

from twc_env.config.environment import EnvConfig
from twc_env.config.mixed_teams import robot_configs


def remarks_on(config: EnvConfig) -> list[str]:
    """A line on each setting that has no effect beside the others, and on carried robots that nobody notices.

    They are no errors: worlds and teams bring such settings along, and a study may set one of two to 0.
    """
    scanners = [own.lidar for own in robot_configs(config)]
    found = []
    if config.building.glass_share and all(lidar.glass_return_probability == 1.0 for lidar in scanners):
        found.append(
            f"building.glass_share = {config.building.glass_share:g} does nothing while "
            "lidar.glass_return_probability = 1, since such glass is a wall to scanners: set that to 0.3, for example"
        )
    dark = [lidar for lidar in scanners if lidar.dark_share]
    if dark and not any(lidar.detection_range_m for lidar in dark):
        found.append(
            f"lidar.dark_share = {dark[0].dark_share:g} does nothing while lidar.detection_range_m = 0, since then all "
            "surfaces give a return: set the range at which a white one does, too"
        )
    if config.clutter.hidden_share and not config.clutter.furniture:
        found.append(
            f"clutter.hidden_share = {config.clutter.hidden_share:g} does nothing while clutter.furniture = 0, since "
            "there are no pieces to hide: set their number, too"
        )
    return found + _unnoticed(config)


def _unnoticed(config: EnvConfig) -> list[str]:
    """The remark on robots that are carried while the engine cannot tell (docs/people.md); none otherwise."""
    failure, slam = config.failure, config.slam
    how = {"failure.kidnap_step": failure.kidnap_step, "failure.kidnaps_per_min": failure.kidnaps_per_min}
    blind = {
        "slam.cues.lidar = false": not slam.cues.lidar,
        "link.scan_on_request = true": config.link.scan_on_request,
        "slam.radio_slam.online = true": slam.radio_slam.online and (slam.cues.wifi or slam.cues.lte),
        f"slam.oracle = {slam.oracle!r}": slam.oracle != "none",
        f"slam.odometry_filter.backend = {slam.odometry_filter.backend!r}": slam.odometry_filter.backend != "compiled",
    }
    carries = [f"{name} = {value:g}" for name, value in how.items() if value]
    hides = [name for name, is_so in blind.items() if is_so]
    if slam.mode != "cooperative" or not carries or not hides:
        return []
    return [
        f"{' and '.join(carries)}: with {' and '.join(hides)} nobody notices that a robot was carried, and its map and "
        "poses are wrong from then on (docs/people.md)"
    ]
