"""Tables of WiFi and signs in the forms that people have them."""

import math

import numpy as np
import pytest

from twc_env.datasets.logs import text_table
from twc_env.datasets.logs.column_units import Span, unit_choices
from twc_env.datasets.logs.readings_table import read_signs, read_wifi
from twc_env.datasets.logs.text_table import TextTable
from twc_env.errors import DataError

BEGUN = 1_700_000_000.0
SPAN = Span(BEGUN, BEGUN + 100.0)
MAC = "aa:bb:cc:dd:ee:0"


def table(tmp_path, text: str):
    path = tmp_path / "a.csv"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    "text",
    [
        f"timestamp,bssid,rssi\n{BEGUN + 1},{MAC}1,-50\n{BEGUN + 1},{MAC}2,-60\n",
        f"t;MAC;level\n{BEGUN + 1:.0f},0;{MAC}2;-60,0\n{BEGUN + 1:.0f},0;{MAC}1;-50,0\n",
        f"time\tap\tRSS [dBm]\n{BEGUN + 1}\tAA-BB-CC-DD-EE-01\t-50\n{BEGUN + 1}\taabb.ccdd.ee02\t-60\n",
        f"dbm, bssid, time_ms\n-50, {MAC}1, {1000 * BEGUN + 1000:.0f}\n-60, {MAC}2, {1000 * BEGUN + 1000:.0f}\n",
        f"time,bssid,rssi\n{1e9 * BEGUN + 1e9:.0f},{MAC}1,-50\n{1e9 * BEGUN + 1e9:.0f},{MAC}2,-60\n",
        f"stamp,bssid,signal strength\n2023-11-14T22:13:21Z,{MAC}1,-50\n2023-11-14T23:13:21+01:00,{MAC}2,-60\n",
        f"{BEGUN + 1},{MAC}1,-50\n{BEGUN + 1},{MAC}2,-60\n",
        f"# wlan0\n\ntime|bssid|rssi\n{BEGUN + 1}|{MAC}1|-50\n{BEGUN + 1}|{MAC}2|-60\n",
        f"# time bssid rssi\n{BEGUN + 1}  {MAC}1 -50\n{BEGUN + 1}  {MAC}2 -60\n",
        f"%time,bssid,rssi\n{1e9 * BEGUN + 1e9:.0f},{MAC}1,-50 dBm\n{1e9 * BEGUN + 1e9:.0f},{MAC}2,-60dBm\n",
        f"time,bssid,rssi\n14.11.2023 22:13:21,{MAC}1,-50\n14.11.2023 22:13:21.0,{MAC}2,-60\n",
        f"time,bssid,rssi\n11/14/2023 10:13:21 PM,{MAC}1,-50\n11/14/2023 10:13:21 PM,{MAC}2,-60\n",
        f"time,bssid,rssi\n2023/11/14 22:13:21,{MAC}1,-50\n2023/11/14 22:13:21,{MAC}2,-60\n",
        f"date,time,bssid,rssi\n2023-11-14,22:13:21,{MAC}1,-50\n2023-11-14,22:13:21,{MAC}2,-60\n",
        f"clock;date;bssid;rssi\n22:13:21,0;14.11.2023;{MAC}1;-50\n22:13:21,0;14.11.2023;{MAC}2;-60\n",
        f"Time\tDate\tbssid\trssi\n10:13:21 PM\t11/14/2023\t{MAC}1\t-50\n10:13:21 PM\t11/14/2023\t{MAC}2\t-60\n",
        f"date,time,{MAC}2,{MAC}1\n14/11/2023,22:13:21,-60,-50\n",
        f"date,time,bssid,rssi\n2023-11-14,{BEGUN + 1},{MAC}1,-50\n2023-11-14,{BEGUN + 1},{MAC}2,-60\n",
        f"time,bssid,rssi,robot\n{BEGUN + 1},{MAC}1,-50,spot\n{BEGUN + 1},{MAC}2,-60,spot\n",
        f"time,{MAC}2,{MAC}1,note\n{BEGUN + 1},-60,-50,x\n",
        f"\ufefftime,bssid,rssi\r\n{BEGUN + 1},{MAC}1,-50\r\n\r\n{BEGUN + 1},{MAC}2,-60\r\n",
    ],
)
def test_separators_names_and_units_are_recognised(tmp_path, text):
    (found,), _ = read_wifi(table(tmp_path, text), SPAN)
    assert found.times_s == pytest.approx([BEGUN + 1.0])
    assert found.values[0].macs.tolist() == [0xAABBCCDDEE01, 0xAABBCCDDEE02]
    assert found.values[0].rssi_dbm == pytest.approx([-50.0, -60.0])


def test_a_table_of_a_spreadsheet_in_utf_16_is_read(tmp_path):
    path = tmp_path / "a.txt"
    path.write_bytes(f"time\tbssid\trssi\n{BEGUN + 1}\t{MAC}1\t-50\n".encode("utf-16"))
    (found,), _ = read_wifi(path, SPAN)
    assert found.times_s.tolist() == [BEGUN + 1]


def test_dates_that_can_be_day_or_month_first_are_asked_for(tmp_path):
    rows = "time,bssid,rssi\n" + f"11/12/2023 08:00:00,{MAC}1,-50\n"
    with pytest.raises(DataError, match="'11/12/2023 08:00:00' can be day or month first; give --units date=dmy or"):
        read_wifi(table(tmp_path, rows), SPAN)
    for order, begun_s in (("dmy", 1_702_281_600.0), ("mdy", 1_699_776_000.0)):
        span = Span(begun_s - 1, begun_s + 1, units=unit_choices([f"date={order}"]))
        assert read_wifi(table(tmp_path, rows), span)[0][0].times_s.tolist() == [begun_s]


def test_dates_beside_times_of_day_that_can_be_day_or_month_first_are_asked_for(tmp_path):
    rows = f"date,time,bssid,rssi\n11/12/2023,08:00:00,{MAC}1,-50\n"
    with pytest.raises(DataError, match="'11/12/2023 08:00:00' can be day or month first; give --units date=dmy or"):
        read_wifi(table(tmp_path, rows), SPAN)
    span = Span(1_702_281_599.0, 1_702_281_601.0, units=unit_choices(["date=dmy"]))
    assert read_wifi(table(tmp_path, rows), span)[0][0].times_s.tolist() == [1_702_281_600.0]


@pytest.mark.parametrize(("day", "clock"), [("2023-11-14", ""), ("", "22:13:22"), ("2023-11-14", "x")])
def test_rows_without_a_date_or_a_time_of_day_are_refused(tmp_path, day, clock):
    rows = f"date,time,bssid,rssi\n2023-11-14,22:13:21,{MAC}1,-50\n{day},{clock},{MAC}1,-50\n"
    with pytest.raises(DataError, match=r"row 3: .*is no time"):
        read_wifi(table(tmp_path, rows), SPAN)


def test_dates_with_points_begin_with_the_day_unless_the_user_says_otherwise(tmp_path):
    text = f"time,bssid,rssi\n11.12.2023 08:00:00,{MAC}1,-50\n"
    for units, begun_s in ((), 1_702_281_600.0), (("date=mdy",), 1_699_776_000.0):
        ((scans,), _) = read_wifi(table(tmp_path, text), Span(begun_s - 1, begun_s + 1, units=unit_choices(units)))
        assert scans.times_s.tolist() == [begun_s]


@pytest.mark.parametrize(
    ("header", "unit"),
    [
        ("secs,nsecs", 1), ("sec,nanosec", 1), ("header.stamp.secs,header.stamp.nsecs", 1), ("stamp_sec,stamp_nsec", 1),
        ("sec,usec", 1000),
    ],
)  # fmt: skip
def test_nanoseconds_beside_seconds_count(tmp_path, header, unit):
    rows = [f"{MAC}1,-50,{BEGUN + k // 2:.0f},{(k % 2) * 900_000_000 // unit}\n" for k in range(4)]
    (found,), notes = read_wifi(table(tmp_path, f"bssid,rssi,{header}\n" + "".join(rows)), SPAN)
    assert found.times_s - BEGUN == pytest.approx([0.0, 0.9, 1.0, 1.9], abs=1e-6)
    assert f"{header.split(',')[1]} are added to {header.split(',')[0]}" in " ".join(notes)


@pytest.mark.parametrize("stamp", ["5,1000000000", "5.5,0", "5,-1", "5,x", "5,"])
def test_nanoseconds_that_are_no_part_of_a_second_are_refused(tmp_path, stamp):
    with pytest.raises(DataError, match="row 2: secs and nsecs must be whole seconds and the rest below one second"):
        read_wifi(table(tmp_path, f"bssid,rssi,secs,nsecs\n{MAC}1,-50,{stamp}\n"), SPAN)


def test_seconds_since_the_log_began_may_have_nanoseconds(tmp_path):
    text = "".join(f"{k},500000000,{MAC}1,-50\n" for k in (0, 80))
    (found,), _ = read_wifi(table(tmp_path, "secs,nsecs,bssid,rssi\n" + text), SPAN)
    assert found.times_s.tolist() == [BEGUN + 0.5, BEGUN + 80.5]


def test_times_since_the_log_began_are_recognised_and_said(tmp_path):
    rows = "".join(f"{t},{MAC}1,-50\n" for t in (0, 40, 99))
    (found,), notes = read_wifi(table(tmp_path, "t,bssid,rssi\n" + rows), SPAN)
    assert found.times_s.tolist() == [BEGUN, BEGUN + 40, BEGUN + 99]
    assert any("from 0 s are taken as since the log began" in note for note in notes)
    with pytest.raises(DataError, match=r"unit of time \(0 to 40\) cannot be told"):
        read_wifi(table(tmp_path, "t,bssid,rssi\n" + rows.replace(f"99,{MAC}1,-50\n", "")), SPAN)


def test_times_of_day_in_another_zone_are_told(tmp_path):
    rows = f"time,bssid,rssi\n2023-11-14T23:13:21,{MAC}1,-50\n"
    with pytest.raises(DataError, match="put both on one clock, or name the time zone, as in"):
        read_wifi(table(tmp_path, rows), SPAN)


def test_what_was_not_heard_is_left_out_and_said(tmp_path):
    rows = [f"{BEGUN},{MAC}{k},{level}" for k, level in enumerate(["-50", "100", "0", "", "nan", "-200"])]
    (found,), notes = read_wifi(table(tmp_path, "time,bssid,rssi\n" + "\n".join(rows)), SPAN)
    assert len(found.values[0].macs) == 1
    assert any("5 readings without a strength" in note for note in notes)


def test_readings_of_close_times_are_one_scan_until_an_address_comes_again(tmp_path):
    rows = [f"{BEGUN + 0.1 * k},{MAC}{k % 3},-50" for k in range(6)]
    (found,), _ = read_wifi(table(tmp_path, "time,bssid,rssi\n" + "\n".join(rows)), SPAN)
    assert [len(scan.macs) for scan in found.values] == [3, 3]


def test_bearings_and_ranges_are_recognised_or_asked_for(tmp_path):
    head = "time,text,bearing,range\n"
    (found,), notes = read_signs(table(tmp_path, head + f"{BEGUN},A 101,-45,2.5\n"), SPAN)
    assert found.values[0].bearing_rad == pytest.approx(-math.pi / 4)
    assert "bearings in deg, ranges in m" in notes[0]
    unsure = table(tmp_path, head + f"{BEGUN},A 101,0.5,2.5\n")
    with pytest.raises(
        DataError, match=r"unit of bearing .* cannot be told; give --units angle=rad or --units angle=deg"
    ):
        read_signs(unsure, SPAN)
    (found,), _ = read_signs(unsure, Span(*((BEGUN, BEGUN + 1)), units=unit_choices(["angle=deg"])))
    assert found.values[0].bearing_rad == pytest.approx(math.radians(0.5))
    told = "timestamp_ms;label;angle [deg];distance (mm)\n" + f"{1000 * BEGUN};A;0,5;900\n"
    (found,), _ = read_signs(table(tmp_path, told), SPAN)
    assert found.values[0].range_m == pytest.approx(0.9)


def test_several_robots_need_a_column(tmp_path):
    span = Span(BEGUN, BEGUN + 10, ("north", "south"))
    with pytest.raises(DataError, match="does not say which of the 2 robots"):
        read_wifi(table(tmp_path, f"time,bssid,rssi\n{BEGUN},{MAC}1,-50\n"), span)
    rows = f"time,robot,bssid,rssi\n{BEGUN},south,{MAC}1,-50\n{BEGUN},0,{MAC}2,-60\n"
    found, _ = read_wifi(table(tmp_path, rows), span)
    assert [own.values[0].macs[0] & 0xF for own in found] == [2, 1]
    with pytest.raises(DataError, match="there is no robot 'west'"):
        read_wifi(table(tmp_path, rows.replace("south", "west")), span)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "is empty"),
        ("x,y,z\n1,2,3\n", "no column for time, address, strength"),
        (f"time,bssid,rssi\n{BEGUN},{MAC}1\n", "row 2: 2 columns, expected 3"),
        (f"time,bssid,rssi,robot\n{BEGUN},{MAC}1,-50,0\n{BEGUN},{MAC}1,-50\n", "row 3: 3 columns, expected 4"),
        (f"time,bssid,rssi\n{BEGUN},{MAC}1,loud\n", "row 2: strength must be a number"),
        (f"time,bssid,rssi\n{BEGUN},{MAC}1,60\n", "no strength is below 0: give dBm"),
        (f"time,bssid,rssi\nyesterday,{MAC}1,-60\n", "row 2: 'yesterday' is no time"),
        (f"time,bssid,rssi\n08:00:00,{MAC}1,-60\n", "row 2: '08:00:00' is no time; give a column date beside it"),
        (f"time,bssid,rssi\n{BEGUN + 5000},{MAC}1,-60\n", "put both on one clock"),
        (f"time,bssid,rssi\n12,{MAC}1,-60\n", "unit of time .* cannot be told; give --units time=s"),
    ],
)
def test_what_cannot_be_told_is_refused_in_one_line(tmp_path, text, told):
    with pytest.raises(DataError, match=told):
        read_wifi(table(tmp_path, text), SPAN)


def test_units_of_the_command_line_are_checked():
    assert unit_choices(["time=ms,angle=deg", "length=cm"]) == {"time": "ms", "angle": "deg", "length": "cm"}
    with pytest.raises(DataError, match=r"--units takes time=s\|ms\|us\|ns"):
        unit_choices(["time=hours"])


def test_simulated_time_is_seconds_if_no_other_unit_meets_the_log(tmp_path):
    (found,), _ = read_wifi(table(tmp_path, f"time,bssid,rssi\n12.5,{MAC}1,-60\n"), Span(5.0, 60.0))
    assert np.array_equal(found.times_s, [12.5])


def test_units_in_the_cells_count(tmp_path):
    rows = "".join(f"{BEGUN + k},A 101,{0.1 * k:.1f} deg,2.5 m\n" for k in range(25))  # as numbers alone: radians
    (found,), notes = read_signs(table(tmp_path, "time,text,bearing,range\n" + rows), SPAN)
    assert found.values[10].bearing_rad == pytest.approx(math.radians(1.0))
    assert "bearings in deg, ranges in m" in notes[0]
    for header, cell in (("bearing", "0.5 rad"), ("bearing [rad]", "0.5 deg")):
        odd = table(tmp_path, f"time,text,{header},range\n{BEGUN},A,0.5 deg,2.5\n{BEGUN},A,{cell},2.5\n")
        with pytest.raises(DataError, match="bearing is given in deg and rad; give all in one unit"):
            read_signs(odd, SPAN)


def test_a_separator_within_a_text_moves_no_columns(tmp_path):
    head, row = "time,text,bearing_deg,range_m\n", f"{BEGUN},A 101,-45,2.5\n"
    moved = f"{BEGUN},Room 5,12,45,2.0\n"  # a text with a comma: its bearing is not 12
    with pytest.raises(DataError, match="row 3: 5 columns, the first row has 4; put texts that hold a separator in"):
        read_signs(table(tmp_path, head + row + moved), SPAN)
    (found,), _ = read_signs(table(tmp_path, head + row + moved.replace("Room 5,12", '"Room 5,12"')), SPAN)
    assert [reading.text for reading in found.values] == ["A 101", "Room 5,12"]
    assert len(read_signs(table(tmp_path, head + row.replace("2.5", "2.5,,")), SPAN)[0][0].values) == 1


def test_separators_of_pages_and_lines_within_a_text_end_no_row(tmp_path):
    head, texts = "time,text,bearing_deg,range_m\n", ["ROOM\x0c12", "HALL\u20283"]
    rows = [f"{BEGUN + k},{text},-45,2.5\n" for k, text in enumerate(texts)]
    found, _ = read_signs(table(tmp_path, head + "".join(rows)), SPAN)
    assert [reading.text for scan in found for reading in scan.values] == texts


def test_a_quote_that_is_not_closed_swallows_no_rows(tmp_path):
    rows = [f"{BEGUN + k},{text},-45,2.5\n" for k, text in enumerate(["A", '"Exit', "B", "C", '"Exit', "D"])]
    with pytest.raises(DataError, match=r"row 6: unexpected end of data; .* and close every quote"):
        read_signs(table(tmp_path, "time,text,bearing_deg,range_m\n" + "".join(rows[:-2] + rows[-1:])), SPAN)
    with pytest.raises(DataError, match="close every quote"):
        read_signs(table(tmp_path, "time,text,bearing_deg,range_m\n" + "".join(rows)), SPAN)
    two_lines = f'time,text,bearing_deg,range_m\n{BEGUN},"Room\n101",-45,2.5\n'
    assert read_signs(table(tmp_path, two_lines), SPAN)[0][0].values[0].text == "Room\n101"


def test_names_of_robots_that_are_numbers_are_names(tmp_path):
    rows = f"time,robot,bssid,rssi\n{BEGUN},1,{MAC}1,-50\n{BEGUN},2,{MAC}2,-60\n"
    found, _ = read_wifi(table(tmp_path, rows), Span(BEGUN, BEGUN + 10, ("1", "2")))
    assert [own.values[0].macs[0] & 0xF for own in found] == [1, 2]
    with pytest.raises(DataError, match="there is no robot '0'; the log has 1, 2"):
        read_wifi(table(tmp_path, rows.replace(",2,", ",0,")), Span(BEGUN, BEGUN + 10, ("1", "2")))


def test_the_receivers_own_address_and_the_storey_are_no_readings(tmp_path):
    rows = f"time,mac,level,{MAC}1,{MAC}2,note\n{BEGUN},{MAC}9,3,-50,-60\n{BEGUN + 1},{MAC}9,3,-51\n"
    (found,), _ = read_wifi(table(tmp_path, rows), SPAN)
    assert [[mac & 0xF for mac in scan.macs] for scan in found.values] == [[1, 2], [1]]
    (found,), _ = read_wifi(table(tmp_path, f"time,{MAC}1\n{BEGUN},-50\n"), SPAN)  # one transmitter
    assert found.values[0].rssi_dbm.tolist() == [-50.0]


def test_readings_without_an_address_are_left_out_and_said(tmp_path):
    (found,), notes = read_wifi(table(tmp_path, f"time,bssid,rssi\n{BEGUN},,-50\n{BEGUN},{MAC}1,-60\n"), SPAN)
    assert found.values[0].rssi_dbm.tolist() == [-60.0]
    assert any("1 readings without an address left out" in note for note in notes)


def test_errors_name_the_line_of_the_file(tmp_path):
    text = f"# wlan0\n\ntime,bssid,rssi\n\n{BEGUN},{MAC}1,-50\n{BEGUN},{MAC}1,loud\n"
    with pytest.raises(DataError, match="row 6: strength must be a number; got 'loud'"):
        read_wifi(table(tmp_path, text), SPAN)


def test_a_comment_with_a_date_is_no_header(tmp_path):
    text = f"# survey, date 2023-11-14\ntime,bssid,rssi\n{BEGUN},{MAC}1,-50\n"
    assert read_wifi(table(tmp_path, text), SPAN)[0][0].values[0].rssi_dbm.tolist() == [-50.0]


def test_a_comment_with_a_number_of_seconds_is_no_header(tmp_path):
    text = f"# one scan every 5 sec\n{BEGUN + 1},{MAC}1,-50\n"
    (found,), notes = read_wifi(table(tmp_path, text), SPAN)
    assert found.times_s.tolist() == [BEGUN + 1] and "without a header" in " ".join(notes)


def test_decimal_commas_need_no_header(tmp_path):
    text = f"{BEGUN:.0f},5;{MAC}1;-50,5\n{BEGUN:.0f},5;{MAC}2;-60,0\n"
    (found,), _ = read_wifi(table(tmp_path, text), SPAN)
    assert found.times_s.tolist() == [BEGUN + 0.5] and found.values[0].rssi_dbm.tolist() == [-50.5, -60.0]


def test_times_without_a_zone_are_told_if_others_have_one(tmp_path):
    rows = f"time,bssid,rssi\n2023-11-14T22:13:21Z,{MAC}1,-50\n2023-11-14T22:13:22{{}},{MAC}2,-60\n"
    for zone, is_told in (("", True), ("+00", False)):
        _, notes = read_wifi(table(tmp_path, rows.format(zone)), SPAN)
        assert any("times without a time zone are taken for UTC" in note for note in notes) == is_told


def test_a_table_of_too_many_cells_is_refused_before_it_is_taken_apart(tmp_path, monkeypatch):
    monkeypatch.setattr(text_table, "CELLS_MAX", 100)
    text = "time,bssid,rssi\n" + f"{BEGUN},{MAC}1,-50\n" * 40
    with pytest.raises(DataError, match=r"has \d+ cells, 100 are possible; cut it into parts"):
        read_wifi(table(tmp_path, text), SPAN)


def test_columns_that_nobody_reads_are_not_repeated_for_every_transmitter(tmp_path):
    names = [f"x{k}" for k in range(500)] + [f"aa:bb:cc:dd:{k // 256:02x}:{k % 256:02x}" for k in range(500)]
    text = ",".join(["time", *names]) + "\n" + ",".join([f"{BEGUN}", *["-50"] * 1000]) + "\n"
    read = TextTable(table(tmp_path, text), ("time", "address", "strength"))
    assert len(read.column("address")) == 500 and max(map(len, read._rows)) == 3
