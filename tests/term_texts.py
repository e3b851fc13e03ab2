"""Terms with constants inside, one of every kind of primitive."""

from __future__ import annotations

TERMS = [
    "sin(2.5*t + 0.4)",
    "cos(1.5*t)*exp(-0.1*t)",
    "tan(0.1*x)/(x**2 + 1.5)",
    "sinh(0.2*x) - cosh(0.3*z)",
    "tanh(3.0*x)*sqrt(z**2 + 0.7)",
    "log(t + 2.5)*Abs(z - 0.1)",
    "asin(0.1*x)*acos(0.1*z)*atan(2.0*x)",
    "atan2(x + 0.3, z + 0.2)",
    "(t + 0.5)**1.7",
    "Max(x, 0.3) + Min(0.5*z, x)",
    "sign(x - 0.01)*x*1.5",
]
