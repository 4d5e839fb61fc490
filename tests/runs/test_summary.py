"""Summaries of runs, and the wording of numbers."""

import dataclasses
import math

import numpy as np
import pytest
from made_up_run import START, made_up

from homeward.estimator import Status
from homeward.reasons import Rejection
from homeward.runs.report import words
from homeward.runs.report.summary import sentence, summarise
from homeward.runs.report.words import describe_moved
from homeward.runs.scoring import score


def test_summary_of_the_usual_run():
    drive, track = made_up(seconds=180.0)
    assert summarise(drive, track, score(track, drive.truth)) == (
        "Localised for 178 of 180 s (99 %, including 1 % on odometry alone), with a standard "
        "deviation below 0.25 m, first after 2.0 s; "
        "no pose for 1 % (longest: 2 of the landmarks that home saw are mapped). "
        "Position error 0.050 m RMSE, 0.050 m median, 0.050 m maximum; heading 0° RMSE. "
        "One landmark was moved since home was stored: a. 7,197 sightings used, 3 rejected."
    )


def test_one_sentence_has_the_result():
    drive, track = made_up(seconds=180.0)
    assert sentence(track, score(track, drive.truth)) == (
        "Localised for 99 % of 180 s, with a standard deviation below 0.25 m; position error "
        "0.050 m RMSE; "
        "1 of the four landmarks seen from home moved: a."
    )
    none = dataclasses.replace(track, x=np.full(track.t.size, np.nan))
    assert sentence(none, score(none, None)).startswith("No pose found in 180 s: 2 of the")
    still = dataclasses.replace(
        track, landmarks=[dataclasses.replace(m, moved=False) for m in track.landmarks]
    )
    assert sentence(still, score(still, None)) == (
        "Localised for 99 % of 180 s, with a standard deviation below 0.25 m; none of the four "
        "landmarks seen from home moved."
    )


def test_time_localised_and_time_with_an_accurate_pose_are_told_apart():
    drive, track = made_up(seconds=180.0)
    growing = np.linspace(0.01, 0.5, track.t.size)[:, None, None] ** 2 * np.eye(3)
    drifting = dataclasses.replace(track, covariance=growing)
    half = "99 % of 180 s, with a standard deviation below 0.25 m for 48 %;"
    assert half in sentence(drifting, score(drifting, None))
    for_20_cm = score(drifting, None, largest_sigma=0.2)
    assert "below 0.20 m for 38 %" in sentence(drifting, for_20_cm)
    assert for_20_cm.as_dict()["accurate_share"] == for_20_cm.accurate_share
    assert "deviation" not in sentence(drifting, score(drifting, None, largest_sigma=np.inf))
    outside = dataclasses.replace(track, covariance=1e-4 * np.eye(3) + 0.0 * track.covariance)
    accuracy = score(outside, drive.truth).accuracy
    assert accuracy.inside_protection_level_share == 0.0  # 5 cm off, with a level of 3.7 cm


def test_summary_reports_overconfidence():
    drive, track = made_up()
    sure = dataclasses.replace(track, covariance=track.covariance / 100)
    said = summarise(drive, sure, score(sure, drive.truth))
    assert "position was outside the 3-sigma ellipse 100 % of the time (expected: 1 %)" in said
    assert "Overconfident" not in summarise(drive, track, score(track, drive.truth))


def test_summary_without_a_pose_gives_the_reason():
    drive, track = made_up(truth=False)
    none = dataclasses.replace(track, x=np.full(track.t.size, np.nan))
    said = summarise(drive, none, score(none, None))
    assert said.startswith(
        "No pose found in 20 s: 2 of the landmarks that home saw are mapped; 3 are needed."
    )


def test_summary_names_what_moved_during_the_drive():
    drive, track = made_up()
    moved = dataclasses.replace(track.landmarks[1], moved=True, moved_at=START + 7.0)
    track = dataclasses.replace(track, landmarks=[*track.landmarks, moved])
    said = summarise(drive, track, score(track, drive.truth))
    assert "One landmark moved during the drive: b (at 7.0 s)." in said


def test_summary_names_landmarks_that_are_exchanged_and_not_as_moved():
    drive, track = made_up()
    pair = [
        dataclasses.replace(track.landmarks[1], landmark=a, moved=True, exchanged_with=b)
        for a, b in (("5", "6"), ("6", "5"))
    ]
    track = dataclasses.replace(track, landmarks=pair)
    said = summarise(drive, track, score(track, None))
    assert "Landmarks 5 and 6 are exchanged." in said
    assert "moved" not in said


def test_no_claim_is_rounded_up():
    assert words.percent(0.9999) == "over 99 %"
    assert words.percent(1.0) == "100 %"
    assert words.percent(0.001) == "under 1 %"
    assert words.percent(0.0) == "0 %"


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0832, "0.083 m"), (0.0996, "0.10 m"), (1.27, "1.3 m"), (9.96, "10 m"), (1234.5, "1,234 m")],
)
def test_quantities_have_two_digits(value, text):
    assert words.quantity(value, "m") == text


def test_lists_end():
    assert words.listing(["a"]) == "a"
    assert words.listing(["a", "b", "c"]) == "a, b and c"
    assert words.listing([*"abcdefghij"], 3) == "a, b, c and 7 more"


def test_landmarks_that_were_not_tested_are_counted():
    drive, track = made_up()
    unmoved = [dataclasses.replace(m, moved=False) for m in track.landmarks]
    track = dataclasses.replace(track, landmarks=unmoved)
    said = summarise(drive, track, score(track, drive.truth))
    assert "No moved landmark among the 4 tested." in said
    assert "not tested" not in said
    unknown = {"moved": None, "moved_probability": math.nan}
    rarely = dataclasses.replace(unmoved[2], **unknown)
    never = dataclasses.replace(unmoved[3], sightings=0, **unknown)
    elsewhere = dataclasses.replace(rarely, home_bearing_stored=math.nan)
    some = dataclasses.replace(track, landmarks=[*unmoved[:2], rarely, never, elsewhere])
    said = summarise(drive, some, score(some, drive.truth))
    others = "Two others seen from home were not tested, 1 of which not seen during the drive."
    assert others in said
    text = sentence(some, score(some, drive.truth))
    assert text.endswith("; none of the two landmarks tested moved.")


def test_boxes_moved_in_a_room_are_named_with_those_in_the_home_image():
    assert describe_moved({}) == "No box was moved since the home image."
    said = describe_moved({"box 3": True, "box 5": False, "box 6": True})
    assert said.startswith("Moved since the home image: box 3, box 5 and box 6; the home image")
    assert "box 5" not in said.split(";")[1]
    assert "none of them" in describe_moved({"box 5": False})


def test_summary_separates_sightings_that_are_not_needed():
    drive, track = made_up(seconds=180.0)
    metrics = score(track, drive.truth)
    rejected = {Rejection.VAGUE_ODOMETRY: 1616, Rejection.OUTSIDE_GATE: 3}
    said = summarise(drive, track, dataclasses.replace(metrics, rejected=rejected))
    assert said.endswith("7,197 sightings used, 1,616 not needed, 3 rejected.")


def test_summary_reports_unverified_poses_and_time_without_a_pose():
    drive, track = made_up(seconds=100.0)
    first = int(np.flatnonzero(track.has_pose)[0])
    t = track.t - track.t[0]
    x, status = track.x.copy(), list(track.status)
    for i in np.flatnonzero(t < 35.0).tolist():
        posed = first <= i and t[i] < 5.0
        status[i] = Status.UNVERIFIED if posed else Status.MAPPING
        x[i] = x[i] if posed else np.nan
    late = dataclasses.replace(track, x=x, status=status)
    said = summarise(drive, late, score(late, None))
    assert "(65 %, including" in said
    assert "first after 35 s; unverified pose for 3 %, no pose for 32 % (longest: " in said


def test_summary_gives_the_reason_for_most_of_the_time_without_a_pose():
    drive, track = made_up(seconds=100.0)
    t = track.t - track.t[0]
    reason = np.where(t < 10.0, "few landmarks; drive on", "no samples").tolist()
    late = dataclasses.replace(track, x=np.where(t < 32.0, np.nan, track.x), reason=reason)
    assert "no pose for 32 % (longest: no samples)." in summarise(drive, late, score(late, None))


def test_ground_truth_in_another_frame_is_reported_as_an_offset():
    drive, track = made_up(seconds=180.0)
    c, s = math.cos(0.7), math.sin(0.7)
    x, y = c * drive.truth.x - s * drive.truth.y + 5.0, s * drive.truth.x + c * drive.truth.y
    truth = dataclasses.replace(drive.truth, x=x, y=y, heading=drive.truth.heading + 0.7)
    metrics = score(track, truth)
    assert metrics.accuracy.has_offset
    assert not score(track, drive.truth).accuracy.has_offset
    assert metrics.as_dict()["position_aligned_rmse_m"] < 0.06
    assert metrics.as_dict()["truth_offset_heading_rad"] == pytest.approx(-0.7, abs=0.01)
    said = summarise(dataclasses.replace(drive, truth=truth), track, metrics)
    assert "ground truth is in another frame, or home is wrong" in said
    assert "Overconfident" not in said
    short = dataclasses.replace(metrics, pose_share=0.02)  # a short piece of a path is rigid
    said = summarise(dataclasses.replace(drive, truth=truth), track, short)
    assert "another frame" not in said
