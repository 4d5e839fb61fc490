"""What is said in words."""

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
        "Localised for 178 of 180 s (99 %), 1 % on odometry alone; the first pose came after "
        "2.0 s. Position error 0.050 m RMSE, 0.050 m median, 0.050 m at worst; heading 0° RMSE. "
        "One landmark was moved since home was stored: a. 7,197 sightings used, 3 rejected."
    )


def test_one_sentence_says_it():
    drive, track = made_up(seconds=180.0)
    assert sentence(track, score(track, drive.truth)) == (
        "In 180 s the robot was localised for 99 % of the time, 0.050 m off (RMSE), "
        "and 1 of the four landmarks that home saw had moved: a."
    )
    none = dataclasses.replace(track, x=np.full(track.t.size, np.nan))
    assert sentence(none, score(none, None)).startswith("In 180 s no pose was found: 2 of the")
    still = dataclasses.replace(
        track, landmarks=[dataclasses.replace(m, moved=False) for m in track.landmarks]
    )
    assert sentence(still, score(still, None)) == (
        "In 180 s the robot was localised for 99 % of the time, "
        "and none of the four landmarks that home saw had moved."
    )


def test_summary_says_when_the_claimed_uncertainty_is_too_small():
    drive, track = made_up()
    sure = dataclasses.replace(track, covariance=track.covariance / 100)
    said = summarise(drive, sure, score(sure, drive.truth))
    assert "for 100 % of the time the true position lay outside its 3-sigma ellipse" in said
    assert "surer" not in summarise(drive, track, score(track, drive.truth))


def test_summary_without_a_pose_gives_the_reason():
    drive, track = made_up(truth=False)
    none = dataclasses.replace(track, x=np.full(track.t.size, np.nan))
    said = summarise(drive, none, score(none, None))
    assert said.startswith(
        "No pose was found in 20 s: 2 of the landmarks that home saw are mapped; 3 are needed."
    )


def test_summary_names_what_moved_during_the_drive():
    drive, track = made_up()
    moved = dataclasses.replace(track.landmarks[1], moved=True, moved_at=START + 7.0)
    track = dataclasses.replace(track, landmarks=[*track.landmarks, moved])
    said = summarise(drive, track, score(track, drive.truth))
    assert "One landmark moved during the drive: b (at 7.0 s)." in said


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


def test_what_is_not_known_to_have_moved_is_told():
    drive, track = made_up()
    unmoved = [dataclasses.replace(m, moved=False) for m in track.landmarks]
    track = dataclasses.replace(track, landmarks=unmoved)
    said = summarise(drive, track, score(track, drive.truth))
    assert "of 4 judged; what carries none of these may have moved unnoticed." in said
    assert "more that home saw" not in said
    unknown = {"moved": None, "moved_probability": math.nan}
    rarely = dataclasses.replace(unmoved[2], **unknown)
    never = dataclasses.replace(unmoved[3], sightings=0, **unknown)
    elsewhere = dataclasses.replace(rarely, home_bearing_stored=math.nan)
    some = dataclasses.replace(track, landmarks=[*unmoved[:2], rarely, never, elsewhere])
    said = summarise(drive, some, score(some, drive.truth))
    assert (
        "Of two others that home saw it is not known; one landmark was not found on the way."
        in said
    )
    told = sentence(some, score(some, drive.truth))
    assert told.endswith("and none of the two landmarks judged had moved.")


def test_what_was_moved_in_a_room_is_told_with_what_of_it_can_be_known():
    assert describe_moved({}) == "Nothing was moved since home."
    said = describe_moved({"box 3": True, "box 5": False, "box 6": True})
    assert said.startswith("Moved since home: box 3, box 5 and box 6; home's picture shows box 3")
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
    assert "with an unverified pose for 3 %, and no pose for 32 %" in said
    assert "the first pose came after 2.0 s, and it was first localised after 35 s" in said


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
    assert "surer" not in said
    short = dataclasses.replace(metrics, pose_share=0.02)  # a short piece of a path is rigid
    said = summarise(dataclasses.replace(drive, truth=truth), track, short)
    assert "another frame" not in said
