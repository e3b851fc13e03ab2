"""The true systems that forms are made of: mechanical, electrical, thermal and others."""

from __future__ import annotations

from form_plants import Plant

OSCILLATOR = Plant(
    "q v",
    "u",
    {"q": "v", "v": "(u - k*q - c*v)/m"},
    {"m": 1.3, "k": 40.0, "c": 0.6},
    (0.3, 0.0),
    drive=(10.0,),
    effects={
        "coulomb_friction": {"v": "-1.0*sign(v)/m"},
        "cubic_stiffness": {"v": "-60.0*q**3/m"},
        "constant_force": {"v": "2.0/m"},
    },
)
PENDULUM = Plant(
    "q v",
    "",
    {"q": "v", "v": "-w2*sin(q) - c*v"},
    {"w2": 30.0, "c": 0.1},
    (1.4, 0.0),
    effects={"quadratic_drag": {"v": "-0.1*v*Abs(v)"}, "coulomb_friction": {"v": "-0.4*sign(v)"}},
)
RAIL = Plant(
    "q v",
    "u",
    {"q": "v", "v": "(u - Fv*v)/M"},
    {"M": 2.0, "Fv": 3.0},
    (0.0, 0.0),
    drive=(10.0,),
    effects={"coulomb_friction": {"v": "-1.5*sign(v)/M"}, "constant_force": {"v": "0.8/M"}},
)
MASSES = Plant(
    "q1 q2 v1 v2",
    "u",
    {
        "q1": "v1",
        "q2": "v2",
        "v1": "(u - k1*q1 - c1*v1 - k2*(q1 - q2))/m1",
        "v2": "(-k2*(q2 - q1) - c2*v2)/m2",
    },
    {"m1": 1.0, "m2": 1.5, "k1": 40.0, "k2": 30.0, "c1": 0.6, "c2": 0.5},
    (0.1, 0.0, 0.0, 0.0),
    drive=(12.0,),
    effects={
        "cubic_stiffness": {"v2": "-80.0*q2**3/m2"},
        "coulomb_friction": {"v1": "-1.0*sign(v1)/m1"},
    },
)
ARM = Plant(
    "q1 q2 w1 w2",
    "tau1 tau2",
    {
        "q1": "w1",
        "q2": "w2",
        "w1": "((b)*(tau1 - d*w1 - G*sin(q1) - h*sin(q1 - q2)*w2**2)"
        " - h*cos(q1 - q2)*(tau2 - d*w2 + h*sin(q1 - q2)*w1**2))"
        "/(a*b - (h*cos(q1 - q2))**2)",
        "w2": "(a*(tau2 - d*w2 + h*sin(q1 - q2)*w1**2)"
        " - h*cos(q1 - q2)*(tau1 - d*w1 - G*sin(q1) - h*sin(q1 - q2)*w2**2))"
        "/(a*b - (h*cos(q1 - q2))**2)",
    },
    {"a": 1.2, "b": 0.5, "h": 0.3, "d": 0.4, "G": 8.0},
    (0.4, -0.2, 0.0, 0.0),
    drive=(6.0, 2.0),
    effects={"constant_force": {"w1": "1.5/a"}, "coulomb_friction": {"w2": "-0.8*sign(w2)"}},
)
MOTOR = Plant(
    "i w th",
    "u",
    {"i": "(u - R*i - Ke*w)/L", "w": "(Ke*i - b*w)/J", "th": "w"},
    {"R": 1.0, "L": 0.05, "Ke": 0.1, "J": 0.002, "b": 0.001},
    (0.0, 0.0, 0.0),
    step=0.002,
    drive=(6.0,),
    effects={
        "coulomb_friction": {"w": "-0.03*sign(w)/J"},
        "constant_force": {"w": "0.02/J"},
        "quadratic_drag": {"w": "-2e-5*w*Abs(w)/J"},
    },
)
HEATER = Plant(
    "T1 T2",
    "P Ta",
    {"T1": "(P - g12*(T1 - T2))/C1", "T2": "(g12*(T1 - T2) - ga*(T2 - Ta))/C2"},
    {"C1": 50.0, "C2": 200.0, "g12": 2.0, "ga": 1.5},
    (22.0, 21.0),
    step=0.5,
    drive=(60.0, 1.0),
    offset=(80.0, 20.0),
    frequencies=(1e-3, 1e-2),
    effects={"constant_force": {"T2": "0.06"}, "power_law_drag": {"T1": "-1e-6*(T1 + 273.0)**2"}},
)
TANK = Plant(
    "h",
    "u",
    {"h": "(Kp*u - a*sqrt(Max(h, 0.0)))/A"},
    {"Kp": 4.0, "a": 3.0, "A": 20.0},
    (2.0,),
    step=0.05,
    drive=(1.0,),
    offset=(1.5,),
    frequencies=(0.005, 0.05),
    effects={"constant_force": {"h": "-0.03"}, "linear_stiffness": {"h": "-0.03*h"}},
)
LEVEL = Plant(
    "z",
    "u",
    {"z": "g*u"},
    {"g": 0.7},
    (0.2,),
    drive=(1.0,),
    effects={"constant_force": {"z": "0.05"}},
)
CIRCUIT = Plant(
    "uc il",
    "us",
    {"uc": "il/C", "il": "(us - uc - R*il)/L"},
    {"C": 0.01, "L": 0.5, "R": 2.0},
    (0.0, 0.0),
    step=0.002,
    drive=(5.0,),
    frequencies=(0.5, 4.0),
    effects={
        "cubic_stiffness": {"il": "-0.01*uc**3/L"},
        "constant_force": {"il": "0.6/L"},
    },
)
SLED = Plant(
    "x vx y vy",
    "fx fy fw",
    {
        "x": "vx",
        "vx": "(fx + ka*fw - c*vx - k*x)/m",
        "y": "vy",
        "vy": "(fy - ka*fw - c*vy - k*y)/m",
    },
    {"m": 2.0, "c": 1.0, "k": 20.0, "ka": 0.5},
    (0.1, 0.0, -0.1, 0.0),
    drive=(5.0, 6.0, 3.0),
    effects={
        "coulomb_friction": {"vx": "-1.0*sign(vx)/m"},
        "cubic_stiffness": {"vy": "-30*y**3/m"},
    },
)
CHAIN = Plant(
    "q1 q2 q3 v1 v2 v3",
    "u",
    {
        "q1": "v1",
        "q2": "v2",
        "q3": "v3",
        "v1": "(u - k1*q1 - c1*v1 - k12*(q1 - q2) - d12*(v1 - v2))/m1",
        "v2": "(-k12*(q2 - q1) - d12*(v2 - v1) - k23*(q2 - q3) - d23*(v2 - v3) - c2*v2)/m2",
        "v3": "(-k23*(q3 - q2) - d23*(v3 - v2) - k3*q3 - c3*v3)/m3",
    },
    {
        **{"m1": 1.0, "m2": 0.8, "m3": 1.2, "k1": 50.0, "k12": 30.0, "k23": 25.0, "k3": 40.0},
        **{"c1": 0.4, "c2": 0.3, "c3": 0.5, "d12": 0.2, "d23": 0.2},
    },
    (0.1, 0.0, -0.05, 0.0, 0.0, 0.0),
    drive=(10.0,),
    effects={"coulomb_friction": {"v2": "-0.5*sign(v2)/m2"}},
)
BALL = Plant(
    "q v",
    "",
    {"q": "v", "v": "-g"},
    {"g": 9.8, "e": 0.8},
    (1.0, 0.0),
    step=0.002,
    longest=2.5,
    effects={"quadratic_drag": {"v": "-0.05*v*Abs(v)"}},
    bounce=("q", "v", "e"),
)
HAMMER = Plant(
    "q v",
    "u",
    {"q": "v", "v": "u - k*(q - 0.3) - c*v"},
    {"k": 60.0, "c": 0.4, "e": 0.7},
    (0.5, 0.0),
    step=0.002,
    longest=40.0,
    drive=(15.0,),
    effects={"constant_force": {"v": "-2.0"}},
    bounce=("q", "v", "e"),
)
PREDATORS = Plant(
    "a b",
    "",
    {"a": "r*a - s*a*b", "b": "p*a*b - d*b"},
    {"r": 1.0, "s": 0.5, "p": 0.3, "d": 0.8},
    (2.0, 1.0),
    step=0.02,
    effects={"quadratic_drag": {"a": "-0.05*a*a"}},
)
VAN_DER_POL = Plant(
    "x v",
    "",
    {"x": "v", "v": "mu*(1.0 - x**2)*v - w2*x"},
    {"mu": 1.2, "w2": 2.0},
    (1.0, 0.0),
    step=0.01,
    effects={"cubic_stiffness": {"v": "-0.3*x**3"}},
)
LORENZ = Plant(
    "x y z",
    "",
    {"x": "s*(y - x)", "y": "x*(r - z) - y", "z": "x*y - b*z"},
    {"s": 10.0, "r": 28.0, "b": 2.667},
    (1.0, 1.0, 20.0),
    step=0.002,
    effects={"constant_force": {"y": "3.0"}},
)
LEAN = Plant(
    "q v",
    "n",
    {"q": "v", "v": "G*sin(q) - c*v + (n - kp*q - kd*v)/J"},
    {"G": 9.0, "c": 0.1, "J": 0.5, "kp": 15.0, "kd": 2.0},
    (0.05, 0.0),
    drive=(2.0,),
    effects={"coulomb_friction": {"v": "-0.3*sign(v)"}},
)
VALVE = Plant(
    "q v f",
    "u",
    {"q": "v", "v": "(f - k*q - c*v)/m", "f": "(u - f)/T"},
    {"m": 1.3, "k": 40.0, "c": 0.6, "T": 0.08},
    (0.3, 0.0, 0.0),
    drive=(10.0,),
    effects={"coulomb_friction": {"v": "-1.0*sign(v)/m"}},
)
STOP = Plant(
    "q v",
    "u",
    {"q": "v", "v": "(u - k*q - c*v - ks*Max(q - qs, 0.0))/m"},
    {"m": 1.3, "k": 40.0, "c": 0.6, "ks": 800.0, "qs": 0.2},
    (0.1, 0.0),
    step=0.002,
    drive=(12.0,),
    effects={"coulomb_friction": {"v": "-1.0*sign(v)/m"}},
)
SHAKEN = Plant(
    "q v",
    "",
    {"q": "v", "v": "A*sin(w*t) - k*q - c*v"},
    {"k": 40.0, "c": 0.6, "A": 8.0, "w": 4.0},
    (0.3, 0.0),
    effects={"cubic_stiffness": {"v": "-80.0*q**3"}},
)
