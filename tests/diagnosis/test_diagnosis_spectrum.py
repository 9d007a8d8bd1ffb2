"""Lines of joint error curves: their truth is a simulator's that knows nothing of the effect."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from cases import diagnose, diagnosed, plant, robot
from numpy_physics import Disturbance, campaign

from casadical.blind_check.mujoco_physics import perturb
from casadical.blind_check.mujoco_physics.stops import Stops, only
from casadical.core.basics import InputError
from casadical.diagnosis.details import Details, analyse
from casadical.diagnosis.diagnose import Diagnosis
from casadical.diagnosis.json_answer import as_json
from casadical.diagnosis.line_search import Line
from casadical.diagnosis.spectrum import JointCurve, Spectrum, curve_of, lines_of, spectrum, spectrum_of, with_multiples
from casadical.diagnosis.text import WIDTH, page_of
from casadical.measurements.reading import from_table

# Joint, cycles a turn, amplitude [rad] and phase at reading zero.
RIPPLES = ((2, 17.0, 80e-6, 0.3), (2, 34.0, 40e-6, 1.0), (3, 8.5, 60e-6, -0.5))
CLEAN = (1, 4, 5, 6)


@dataclass(frozen=True)
class Ripple(Disturbance):
    joint: int
    cycles: float
    size: float
    phase: float

    def misread(self, stops: Stops) -> np.ndarray:
        return only(self.joint, self.size * np.sin(self.cycles * stops.q[:, self.joint - 1] + self.phase))


@cache
def rippled() -> Diagnosis:
    built = perturb(plant(robot("ur10e")), 1)
    table = campaign(built, 240, 1, disturbances=[Ripple(*r) for r in RIPPLES], noise_mm=0.015)
    return diagnose(robot("ur10e"), from_table(table, 6), ["joint_error_curve"])


@cache
def found() -> Spectrum:
    return spectrum(rippled())


def curve(joint: int) -> JointCurve:
    return found().joints[joint - 1]


def test_lines_of_whole_and_broken_numbers_of_cycles_are_found() -> None:
    for joint in (2, 3):
        truth = sorted((r for r in RIPPLES if r[0] == joint), key=lambda r: -r[2])
        lines = curve(joint).lines
        assert len(lines) == len(truth)
        for line, (_, cycles, size, phase) in zip(lines, truth, strict=True):
            assert line.frequency == pytest.approx(cycles, abs=3 * line.frequency_error)
            assert line.frequency_error < 0.12
            assert line.amplitude == pytest.approx(size, abs=3 * line.amplitude_error)
            assert line.amplitude_error < 0.1 * line.amplitude
            off = (line.phase - phase + np.pi) % (2 * np.pi) - np.pi
            assert abs(off) < 3 * line.phase_error
            assert line.p < 1e-10


def test_no_line_is_found_where_there_is_none() -> None:
    assert [line for joint in CLEAN for line in curve(joint).lines] == []


def test_a_harmonic_is_said_to_be_one() -> None:
    first, second = curve(2).lines
    assert (first.multiple_of, second.multiple_of, second.factor) == (None, first.frequency, 2)


@pytest.mark.parametrize("highest", [17.1, 16.0])
def test_nothing_is_named_at_the_edge(highest: float) -> None:
    lines = spectrum(rippled(), highest).joints[1].lines
    assert all(abs(line.frequency - highest) > 1 for line in lines)


def test_a_curve_holds_its_ripples_where_there_are_readings() -> None:
    c = curve(2)
    truth = sum(size * np.sin(cycles * c.angle + phase) for joint, cycles, size, phase in RIPPLES if joint == 2)
    inside = np.abs(c.value - truth) < 1.96 * c.error
    assert inside[c.covered].mean() > 0.85
    assert c.rms == pytest.approx(np.sqrt((80e-6**2 + 40e-6**2) / 2), abs=2 * c.rms_error)
    assert c.rms > 2 * c.rms_error
    assert c.middle == pytest.approx((17, 17), abs=1)  # four fifths of its square


def test_the_band_grows_where_there_are_no_readings() -> None:
    for c in found().joints:
        if not c.covered.all():
            assert c.error[~c.covered].mean() > c.error[c.covered].mean()


def test_shares_are_of_the_joints_that_have_curves() -> None:
    shares = [c.share for c in found().joints]
    assert sum(shares) == pytest.approx(1)
    assert shares[1] > shares[2] > 0.05 > max(shares[j - 1] for j in CLEAN)


def test_scan_has_the_standard_error_of_each_sine() -> None:
    """Of clean joints the sines are noise: half of them are below 1.18 standard errors (Rayleigh's distribution)."""
    second = curve(2).scan
    at = int(np.argmin(np.abs(second.frequency - 17.0)))
    assert second.amplitude[at] == pytest.approx(80e-6, abs=15e-6)
    assert second.amplitude[at] > 8 * second.error[at]
    clean = [curve(j).scan.amplitude / curve(j).scan.error for j in (1, 4)]
    assert 0.6 < np.median(np.concatenate(clean)) < 2.0


def test_highest_line_of_an_analysis() -> None:
    more = analyse(rippled(), poses=1, highest_line=100.0)
    assert more.curves is not None
    assert all(c.scan.frequency[-1] == pytest.approx(100, abs=0.5) for c in more.curves.joints)
    assert [round(line.frequency) for line in more.curves.joints[1].lines][:2] == [17, 34]


def test_a_diagnosis_without_curves_has_no_spectrum() -> None:
    with pytest.raises(InputError, match="no joint error curve was found"):
        spectrum(diagnosed("ur10e-P03"))


@pytest.mark.parametrize("highest", [0.0, -3.0, float("nan"), 1e9])
def test_a_frequency_that_cannot_be_is_refused(highest: float) -> None:
    with pytest.raises(InputError, match="give cycles a turn from 1 to"):
        spectrum(rippled(), highest)


@pytest.mark.parametrize("why", ["it did not move", "it moves nothing"])
def test_a_joint_that_shows_nothing_has_no_lines(why: str) -> None:
    d = rippled()
    q, Jq = d.case.m.q.copy(), d.case.whole.Jq.copy()
    if why == "it did not move":
        q[:, 2] = 0.3
    else:
        Jq[:, :, 2] = 0.0
    case = replace(d.case, m=replace(d.case.m, q=q), whole=replace(d.case.whole, Jq=Jq))
    third = spectrum_of(case, curve_of(d.causes), d.columns, d.noise).joints[2]
    assert third.lines == ()
    assert np.isfinite(third.error).all()


def test_multiples_of_the_same_joint_alone_are_marked() -> None:
    lines = [
        Line(1, f, 0.05, size, 1e-6, 0.0, 0.1, 1e-9) for f, size in ((17, 9e-5), (34.02, 5e-5), (7.0, 4e-5), (40, 3e-5))
    ]
    assert [(a.multiple_of, a.factor) for a in with_multiples(lines)] == [(None, 1), (17, 2), (None, 1), (None, 1)]


def test_what_lines_suggest_is_said_of_shared_and_of_known_ratios() -> None:
    def line(joint: int, f: float) -> Line:
        return Line(joint, f, 0.01, 5e-5, 1e-6, 0.0, 0.1, 1e-9)

    def joint(number: int, *lines: Line) -> JointCurve:
        c = found().joints[number - 1]
        return JointCurve(**{**c.__dict__, "joint": number, "lines": lines})

    both = Spectrum((joint(1, line(1, 50.0)), joint(2, line(2, 50.01), line(2, 23.4))), 60).suggestions
    assert any("joints 1, 2" in s for s in both)
    assert sum("ratio 50" in s for s in both) == 2
    assert not any("23.4" in s for s in both)
    assert Spectrum((joint(1, line(1, 41.3)),), 60).suggestions == ()
    many = [line(1, 10.0 + k) for k in range(6)]
    assert [lines_of(joint(1, *many[:k])).endswith(" and 2 more") for k in (4, 6)] == [False, True]


def table_of_curves() -> list[str]:
    lines = page_of(rippled(), Details(curves=found())).splitlines()
    start = next(k for k, line in enumerate(lines) if line.split()[:2] == ["joint", "rms"])
    return lines[start : start + 1 + len(found().joints)]


def test_the_page_has_a_row_for_each_joint_and_no_coefficient() -> None:
    page = page_of(rippled(), Details(curves=found()))
    assert max(map(len, page.splitlines())) <= WIDTH
    assert "s1_q" not in page
    assert "harmonics of each joint 60" in page
    head, *rows = table_of_curves()
    assert head.split()[-1] == "urad)"
    assert [int(row.split()[0]) for row in rows[:2]] == [2, 3]
    assert sorted(int(row.split()[0]) for row in rows) == [1, 2, 3, 4, 5, 6]
    assert "= 2 x" in rows[0]
    assert "nothing seen" in rows[-1]


def test_the_answer_has_lines_and_no_coefficients() -> None:
    answer = as_json(rippled(), "rippled", Details(curves=found()))
    assert answer["causes"][0]["effect"] == "joint_error_curve"
    assert answer["causes"][0]["parameters"] == {}
    curves = answer["curves"]
    assert curves["harmonics"] == 60
    second = curves["joints"][1]
    assert [round(line["cycles"]) for line in second["lines"]] == [17, 34]
    assert second["lines"][1]["factor"] == 2
    q = np.rad2deg(rippled().case.m.q[:, 1])
    inside = [(low <= (q + 180) % 360 - 180) & ((q + 180) % 360 - 180 <= high) for low, high in second["covered_deg"]]
    assert np.any(inside, axis=0).mean() > 0.95
    assert "curves" not in as_json(rippled(), "rippled")
