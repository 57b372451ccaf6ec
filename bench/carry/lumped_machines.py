"""The lumped machines of the ruler: a lathe, a borer, a spindle that only warms up, a heated bed."""

from __future__ import annotations

from carry.lumped import Heat, LumpedMachine, Plan, Probe, Slope
from carry.network import network
from carry.work import Air

# A production lathe: many short campaigns on a machine that was at work before, air conditioning at different levels,
# coolant, 24 sensors. The bearings push harder the warmer they are: a kelvin counts by the level it starts at.
LATHE = LumpedMachine(
    name="lumped lathe",
    network=network(
        nodes={
            "front bearing": 9.0, "rear bearing": 6.0, "shaft": 25.0, "headstock": 120.0, "headstock foot": 90.0,
            "motor": 45.0, "chuck": 30.0, "bed left": 260.0, "bed right": 260.0, "cross slide": 70.0, "turret": 45.0,
            "X nut": 3.0, "X screw": 12.0, "X motor": 9.0, "Z nut": 5.0, "Z screw": 28.0, "Z motor": 12.0,
            "tank": 160.0, "hydraulics": 40.0,
        },
        links=[
            ("front bearing", "shaft", 18.0), ("rear bearing", "shaft", 14.0), ("front bearing", "headstock", 45.0),
            ("rear bearing", "headstock", 30.0), ("headstock", "headstock foot", 60.0),
            ("motor", "headstock foot", 9.0), ("shaft", "chuck", 25.0), ("headstock foot", "bed left", 40.0),
            ("bed left", "bed right", 35.0),
            ("bed right", "cross slide", 6.0), ("cross slide", "turret", 20.0), ("X nut", "cross slide", 8.0),
            ("X nut", "X screw", 9.0), ("X screw", "X motor", 4.0), ("X motor", "cross slide", 3.0),
            ("Z nut", "bed right", 8.0), ("Z nut", "Z screw", 11.0), ("Z screw", "Z motor", 5.0),
            ("Z motor", "bed right", 4.0), ("tank", "bed left", 12.0), ("hydraulics", "headstock foot", 10.0),
        ],
        still=[
            ("headstock", "air", 14.0), ("headstock foot", "air", 9.0), ("motor", "air", 12.0), ("chuck", "air", 3.0),
            ("bed left", "air", 16.0), ("bed right", "air", 18.0), ("cross slide", "air", 7.0), ("turret", "air", 4.0),
            ("X motor", "air", 2.5), ("Z motor", "air", 3.0), ("X screw", "air", 0.8), ("Z screw", "air", 2.0),
            ("tank", "air", 11.0), ("hydraulics", "air", 9.0), ("tank", "coolant", 1.0),
            ("bed left", "floor", 14.0), ("bed right", "floor", 14.0),
        ],
        flow=[
            ("chuck", "air", 22.0), ("turret", "coolant", 14.0), ("bed right", "coolant", 16.0),
            ("tank", "coolant", 30.0),
        ],
    ),
    heats=(
        Heat("front bearing", "spindle", 520.0, friction=True), Heat("rear bearing", "spindle", 330.0, friction=True),
        Heat("motor", "spindle", 900.0), Heat("X nut", "X", 60.0, friction=True), Heat("X motor", "X", 130.0),
        Heat("Z nut", "Z", 120.0, friction=True), Heat("Z motor", "Z", 190.0), Heat("tank", "coolant", 350.0),
        Heat("hydraulics", "on", 260.0),
    ),
    probes=(
        Probe("s01", "front bearing", "bearing"), Probe("s02", "front bearing", "bearing", "", 0.1, 90.0),
        Probe("s03", "rear bearing", "bearing"), Probe("s04", "headstock"), Probe("s05", "headstock", air_share=0.15),
        Probe("s06", "headstock foot"), Probe("s07", "motor", "drive", air_share=0.05), Probe("s08", "bed left"),
        Probe("s09", "bed left", air_share=0.2), Probe("s10", "bed right"), Probe("s11", "bed right", lag_s=300.0),
        Probe("s12", "cross slide"), Probe("s13", "turret", air_share=0.1), Probe("s14", "X nut", "drive", "X"),
        Probe("s15", "X motor", "drive", "X"), Probe("s16", "Z nut", "drive", "Z"),
        Probe("s17", "Z motor", "drive", "Z"),
        Probe("s18", "Z motor", "drive", "Z", 0.2), Probe("s19", "tank", "fluid"), Probe("s20", "hydraulics", "fluid"),
        Probe("s21", "air", "ambient"), Probe("s22", "air", "ambient", "", 0.0, 400.0),
        Probe("s23", "floor", "foundation"),
        Probe("s24", "coolant", "fluid"),
    ),
    drift={
        "front bearing": (0.25, 0.0, 0.5), "shaft": (0.1, 0.0, 1.9), "headstock": (2.1, 0.0, 0.9),
        "headstock foot": (-0.7, 0.0, 0.4), "bed left": (-0.9, 0.0, -1.1), "bed right": (0.8, 0.0, -1.6),
        "cross slide": (1.1, 0.0, 0.0), "X screw": (-1.7, 0.0, 0.0), "Z screw": (0.0, 0.0, -2.2),
        "turret": (-0.9, 0.0, 0.5),
    },
    curved={"front bearing": (0.035, 0.0, 0.01), "X screw": (0.05, 0.0, 0.0)},
    plan=Plan("parts", hours=(4.0, 6.0), cool_h=0.0, before_h=(2.0, 20.0), pause_h=(0.2, 9.0), drift_every_s=300.0),
    air=Air(level_degC=(17.0, 28.0), daily_K=1.2, weather_K=0.8, regulation_K=0.6),
    seed=4101,
    directions="XZ",
    travel_mm={"X": (0.0, 300.0), "Z": (0.0, 900.0)},
)  # fmt: skip

# A horizontal borer: few long campaigns with sweeps of three axes, written down without the other axes' positions.
BORER = LumpedMachine(
    name="lumped borer",
    network=network(
        nodes={
            "front bearing": 14.0, "rear bearing": 9.0, "quill": 60.0, "ram front": 150.0, "ram rear": 150.0,
            "motor": 80.0, "gear": 55.0, "slide": 240.0, "column front": 700.0, "column rear": 700.0,
            "column foot": 500.0, "bed": 1200.0, "X nut": 8.0, "X screw": 60.0, "Y nut": 8.0, "Y screw": 45.0,
            "Z nut": 6.0, "Z screw": 25.0, "cabinet": 60.0,
        },
        links=[
            ("front bearing", "quill", 20.0), ("rear bearing", "quill", 16.0), ("front bearing", "ram front", 50.0),
            ("rear bearing", "ram rear", 35.0), ("ram front", "ram rear", 55.0), ("gear", "ram rear", 40.0),
            ("motor", "ram rear", 10.0), ("ram rear", "slide", 25.0), ("ram front", "slide", 18.0),
            ("slide", "column front", 22.0), ("column front", "column rear", 90.0),
            ("column rear", "column foot", 60.0),
            ("column front", "column foot", 60.0), ("column foot", "bed", 70.0), ("X nut", "X screw", 14.0),
            ("X nut", "column foot", 9.0), ("Y nut", "Y screw", 13.0), ("Y nut", "slide", 9.0),
            ("Z nut", "Z screw", 10.0),
            ("Z nut", "ram rear", 7.0), ("cabinet", "column rear", 12.0), ("X screw", "bed", 6.0),
            ("Y screw", "column front", 6.0),
        ],
        still=[
            ("ram front", "air", 10.0), ("ram rear", "air", 9.0), ("motor", "air", 16.0), ("slide", "air", 15.0),
            ("column front", "air", 34.0), ("column rear", "air", 34.0), ("column foot", "air", 20.0),
            ("bed", "air", 40.0),
            ("bed", "floor", 90.0), ("cabinet", "air", 14.0), ("X screw", "air", 4.0), ("Y screw", "air", 3.0),
            ("Z screw", "air", 2.0), ("gear", "air", 6.0),
        ],
        flow=[("quill", "air", 12.0)],
    ),
    heats=(
        Heat("front bearing", "spindle", 700.0, friction=True), Heat("rear bearing", "spindle", 420.0, friction=True),
        Heat("gear", "spindle", 520.0, friction=True), Heat("motor", "spindle", 1100.0), Heat("cabinet", "on", 320.0),
        Heat("X nut", "X", 210.0, friction=True), Heat("Y nut", "Y", 180.0, friction=True),
        Heat("Z nut", "Z", 120.0, friction=True),
    ),
    probes=(
        Probe("b01", "front bearing", "bearing"), Probe("b02", "rear bearing", "bearing"), Probe("b03", "ram front"),
        Probe("b04", "ram rear"), Probe("b05", "gear", "bearing"), Probe("b06", "motor", "drive", "", 0.08),
        Probe("b07", "slide"), Probe("b08", "column front", air_share=0.1), Probe("b09", "column rear", air_share=0.1),
        Probe("b10", "column foot"), Probe("b11", "bed", lag_s=200.0), Probe("b12", "X nut", "drive", "X"),
        Probe("b13", "Y nut", "drive", "Y"), Probe("b14", "Z nut", "drive", "Z"), Probe("b15", "air", "ambient"),
        Probe("b16", "floor", "foundation"),
    ),
    drift={
        "quill": (0.2, 0.4, 6.5), "ram front": (0.6, 3.2, 4.0), "ram rear": (0.4, -1.5, 5.0), "slide": (0.5, 4.5, 1.0),
        "column front": (0.2, 9.0, -7.0), "column rear": (0.2, 8.0, 7.5), "column foot": (1.2, 4.0, 0.5),
        "bed": (0.4, -3.0, 0.6), "Y screw": (0.0, -2.5, 0.0), "X screw": (-3.0, 0.0, 0.0), "Z screw": (0.0, 0.0, -3.5),
    },
    curved={"front bearing": (0.0, 0.02, 0.05)},
    slopes=(
        Slope("X", "X screw", (9.0, 0.0, 0.0)), Slope("X", "bed", (2.0, 1.5, 0.4), (0.0, -2.2, 0.0)),
        Slope("X", "column foot", (0.5, -2.0, 0.8)), Slope("Y", "Y screw", (0.0, 9.5, 0.0)),
        Slope("Y", "column front", (0.8, 1.0, -6.0), (0.0, 0.0, -1.8)),
        Slope("Y", "column rear", (-0.6, 1.0, 6.2), (0.0, 0.0, 1.9)), Slope("Z", "Z screw", (0.0, 0.0, 8.0)),
        Slope("Z", "ram front", (0.4, -2.5, 1.0)), Slope("Z", "ram rear", (-0.3, 2.1, 1.5)),
    ),
    plan=Plan("parts", (6.5, 8.0), cool_h=3.0, before_h=(1.0, 8.0), pause_h=(8.0, 14.0), drift_every_s=0.0,
              sweep_every_min=45.0, points=9),
    air=Air(level_degC=(16.0, 26.0), daily_K=1.8, weather_K=1.0, regulation_K=0.2),
    seed=4202,
    travel_mm={"X": (0.0, 2500.0), "Y": (0.0, 1800.0), "Z": (0.0, 900.0)},
    rpm_max=2500.0, gauge_noise_um=1.2, gauge_resolution_um=0.1, sample_s=60.0,
)  # fmt: skip

# A spindle on a test stand: warm-ups that are nearly alike, each from a cold machine. The shaft, which no thermometer
# sees, grows most; the clock knows nearly all.
WARM_UP = LumpedMachine(
    name="lumped warm-ups",
    network=network(
        nodes={
            "front bearing": 5.0, "rear bearing": 4.0, "shaft": 14.0, "housing front": 40.0, "housing rear": 35.0,
            "stator": 25.0, "jacket": 12.0, "flange": 60.0, "stand": 300.0,
        },
        links=[
            ("front bearing", "shaft", 12.0), ("rear bearing", "shaft", 10.0), ("front bearing", "housing front", 40.0),
            ("rear bearing", "housing rear", 30.0), ("stator", "jacket", 60.0), ("stator", "shaft", 5.0),
            ("jacket", "housing front", 22.0), ("jacket", "housing rear", 22.0), ("housing front", "flange", 35.0),
            ("flange", "stand", 18.0),
        ],
        still=[
            ("housing front", "air", 4.0), ("housing rear", "air", 4.0), ("flange", "air", 3.0), ("stand", "air", 12.0),
            ("jacket", "water", 40.0),
        ],
        flow=[("shaft", "air", 6.0)],
    ),
    heats=(
        Heat("front bearing", "spindle", 420.0, friction=True), Heat("rear bearing", "spindle", 300.0, friction=True),
        Heat("stator", "spindle", 900.0),
    ),
    probes=tuple(
        Probe(f"w{k + 1:02d}", place, role, "", share, lag_s)
        for k, (place, role, share, lag_s) in enumerate(
            [(p, "bearing", s, t) for p in ("front bearing", "rear bearing") for s, t in ((0.15, 60.0), (0.3, 150.0))]
            + [(p, "structure", s, t) for p in ("housing front", "housing rear", "flange", "stand")
               for s, t in ((0.0, 30.0), (0.1, 30.0), (0.2, 120.0))]
            + [("jacket", "fluid", 0.0, 30.0), ("stator", "structure", 0.0, 60.0), ("air", "ambient", 0.0, 60.0),
               ("air", "ambient", 0.0, 300.0), ("water", "fluid", 0.0, 30.0), ("jacket", "fluid", 0.1, 60.0)]
        )
    ),
    drift={
        "shaft": (0.1, 0.0, 2.6), "front bearing": (0.15, 0.2, 0.4), "housing front": (0.3, 1.2, -1.1),
        "housing rear": (-0.1, -0.5, -0.4), "flange": (0.2, 0.9, 0.7),
    },
    curved={"front bearing": (0.0, 0.0, 0.012)},
    plan=Plan("warm-up", (3.5, 3.5), cool_h=0.0, before_h=(0.1, 0.1), pause_h=(16.0, 24.0), drift_every_s=60.0),
    air=Air(level_degC=(20.5, 22.0), daily_K=0.3, weather_K=0.2),
    seed=4303,
    rpm_max=12000.0, with_duty=False, gauge_noise_um=0.15, gauge_resolution_um=0.1, sensor_noise_K=0.02, sample_s=30.0,
)  # fmt: skip

# A heated bed: one thermometer at the heater, and a plate that follows late. Three sensors, no duty.
BED = LumpedMachine(
    name="lumped heated bed",
    network=network(
        nodes={"heater": 1.2, "plate": 6.0, "carrier": 4.0, "frame": 25.0},
        links=[("heater", "plate", 2.2), ("plate", "carrier", 1.1), ("carrier", "frame", 1.4)],
        still=[("plate", "air", 1.8), ("carrier", "air", 0.6), ("frame", "air", 4.0)],
    ),
    heats=(Heat("heater", "spindle", 110.0),),
    probes=(
        Probe("bed", "heater", "drive", lag_s=20.0), Probe("frame", "frame"), Probe("air", "air", "ambient"),
    ),
    drift={"plate": (0.2, 0.1, -0.75), "carrier": (0.4, 0.0, -0.5), "frame": (-0.3, 0.2, 0.9)},
    plan=Plan("heating", (1.0, 2.0), cool_h=1.0, before_h=(0.1, 1.0), pause_h=(0.5, 10.0), drift_every_s=20.0),
    air=Air(level_degC=(18.0, 25.0), daily_K=0.5, weather_K=0.4),
    seed=4404,
    with_duty=False, gauge_noise_um=0.6, gauge_resolution_um=0.5, sample_s=10.0,
)  # fmt: skip

LUMPED = {"lathe": LATHE, "borer": BORER, "warm-ups": WARM_UP, "heated bed": BED}
