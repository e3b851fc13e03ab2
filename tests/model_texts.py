"""Model files that several tests read."""

EVERYTHING = """
[model]
name = "every table, \\"quoted\\""
time = "t"
states = ["q", "v", "z"]
inputs = ["u"]
outputs = ["y", "w"]
input_hold = "zero"
sample_time = 0.01

[definitions]
stretch = "q - z"
pull = "k*stretch"

[equations]
q = "v"
v = "u - Fc*sign(v) - pull"
z = "(q - z)/tau"

[inertia]
v = { v = "M" }

[readings]
y = "q + y0"
w = "v"

[parameters]
M = { value = 2.0, unit = "kg", bounds = [1.0, 3.0] }
k = { value = 1e-300, unit = "N/m" }
Fc = { value = 0.1, unit = "N", bounds = [0.0, 1.0] }
tau = { value = 0.1, unit = "s" }
y0 = { value = 0.0, unit = "m" }
s = 1e-4

[per_recording]
y0 = { "a file.csv" = 0.1, "b.csv" = -2.0 }

[initial]
q = 0.25
v = "free"
z = "free"

[delays]
u = 0.002
y = "tau"

[clock]
y = "1 + s"

[noise]
y = 1e-6

[resolution]
y = 1e-5

[[events]]
when = "q"
direction = -1
reset = { v = "-0.8*v" }

[units]
t = "s"
q = "m"
v = "m/s"
z = "m"
u = "N"
y = "m"
w = "m/s"

[columns]
t = "time_s"
u = "motor force (N)"
"""
