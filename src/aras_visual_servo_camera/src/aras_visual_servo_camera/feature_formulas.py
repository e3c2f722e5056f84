"""The features, each defined by one formula. Formulas may use moments and other features.

The formulas are functions of the moments m_ij and mu_ij (named m20, mu20, ...), the area a (for a
set of points: mu20 + mu02), the centre of gravity xg, yg, and the area a_star and depth Z_star of
the desired view. The polynomials I1 ... I15 are invariant to a rotation of the image. The ratios
C1 ... C10 are also invariant to its scale.

References: F. Chaumette, Image moments: a general and useful set of features for visual
servoing, IEEE T-RO 20(4), 2004 (Sx, Sy, Px, Py); O. Tahri and F. Chaumette, Point-based and
region-based image moments for visual servoing of planar objects, IEEE T-RO 21(6), 2005
(xn, yn, an, I and C).
"""

from __future__ import annotations

from .formula import Formula

_SOURCES = {
    # an, xn and yn: area and centre of gravity, normalised so that they are linear in the camera's
    # translation (Tahri and Chaumette 2005).
    "an": "Z_star * sqrt(a_star / a)",
    "xn": "an * xg",
    "yn": "an * yg",
    "area": "a + 0",
    "alpha": "atan2(2 * mu11, mu20 - mu02) / 2",
    # Order 2
    "I1": "mu11**2 - mu20 * mu02",
    "I2": "(mu20 - mu02)**2 + 4 * mu11**2",
    # Order 3
    "I3": "(mu30 - 3 * mu12)**2 + (3 * mu21 - mu03)**2",
    "I4": "(mu30 + mu12)**2 + (mu21 + mu03)**2",
    "I5": (
        "-mu30**2 * mu03**2 + 6 * mu30 * mu21 * mu12 * mu03 - 4 * mu30 * mu12**3"
        " - 4 * mu21**3 * mu03 + 3 * mu21**2 * mu12**2"
    ),
    "I6": (
        "3 * mu12**4 + 2 * mu30 * mu12**3 + 3 * mu30**2 * mu12**2 - 6 * mu03 * mu21 * mu12**2"
        " - 6 * mu30 * mu21**2 * mu12 - 6 * mu30 * mu21 * mu03 * mu12 + 2 * mu30**2 * mu03**2"
        " + 2 * mu21**3 * mu03 + 3 * mu21**2 * mu03**2 + 3 * mu21**4"
    ),
    "I7": (
        "(3 * mu21 + 2 * mu03) * mu12**3 + 3 * mu30 * (mu03 + 2 * mu21) * mu12**2"
        " - 3 * mu21 * mu12 * ((mu03 + mu21)**2 - mu30**2)"
        " + mu30 * (mu03**3 - mu30**2 * mu03 - 2 * mu21**3 - 3 * mu03 * mu21**2)"
    ),
    "I8": (
        "3 * mu03 * mu21**3 - 2 * mu03**2 * mu21**2 + mu21**2 * mu30**2"
        " + 3 * mu12**2 * mu03 * mu21 - mu03 * mu21 * mu30**2 - mu03**3 * mu21"
        " + 3 * mu12**3 * mu30 - 2 * mu12**2 * mu30**2 + mu12**2 * mu03**2 - mu12 * mu30**3"
        " - mu12 * mu30 * mu03**2 + 3 * mu12 * mu30 * mu21**2 - 6 * mu12 * mu30 * mu03 * mu21"
    ),
    "I9": "(mu30**2 + 3 * mu30 * mu12 + 3 * mu03 * mu21 + mu03**2)**2",
    # Order 4
    "I10": "mu40 * mu04 - 4 * mu31 * mu13 + 3 * mu22**2",
    "I11": (
        "3 * mu13**2 + 2 * mu31 * mu13 - 3 * (mu40 + mu04) * mu22 - 2 * mu40 * mu04 + 3 * mu31**2"
    ),
    "I12": (
        "3 * mu04**2 + 2 * mu40 * mu04 + 12 * mu22 * mu04 + 3 * mu40**2 + 12 * mu40 * mu22"
        " + 16 * mu31 * mu13"
    ),
    # Order 5
    "I13": "(mu50 + 2 * mu32 + mu14)**2 + (mu05 + 2 * mu23 + mu41)**2",
    "I14": "(mu50 - 2 * mu32 - 3 * mu14)**2 + (mu05 - 2 * mu23 - 3 * mu41)**2",
    "I15": "(mu50 - 10 * mu32 + 5 * mu14)**2 + (mu05 - 10 * mu23 + 5 * mu41)**2",
    "C1": "I1 / I2",
    "C2": "I3 / I4",
    "C3": "I5 / I6",
    "C4": "I7 / I6",
    "C5": "I8 / I6",
    "C6": "I9 / I6",
    "C7": "I11 / I10",
    "C8": "I12 / I10",
    "C9": "I13 / I15",
    "C10": "I14 / I15",
    # Features of Chaumette 2004, with intermediate formulas such as cos2. Sx and Sy are for
    # asymmetric objects, Px and Py for symmetric objects.
    "cos2": "mu20 - mu02",
    "sin2": "2 * mu11",
    "cos3": "mu03 - 3 * mu21",
    "sin3": "mu30 - 3 * mu12",
    "cos4": "cos2**2 - sin2**2",
    "sin4": "2 * sin2 * cos2",
    "J1": "cos2**2 + sin2**2",
    "J2": "cos3**2 + sin3**2",
    "J3": "mu20 + mu02",
    "K": "J1 * J3 * sqrt(J3) / sqrt(a)",
    "Sx": "(cos3 * cos4 + sin3 * sin4) / K",
    "Sy": "(sin3 * cos4 - cos3 * sin4) / K",
    "Px": "J1 / J3**2",
    "Py": "a * J2 / J3**3",
    # Kn, Sxn, Syn and Pyn are K, Sx, Sy and Py with m00 instead of a. For a region, a is m00, so
    # they are equal. For a set of points, a = mu20 + mu02 depends on the scale, so only the
    # formulas with m00 are invariant to scale.
    "Kn": "J1 * J3 * sqrt(J3) / sqrt(m00)",
    "Sxn": "(cos3 * cos4 + sin3 * sin4) / Kn",
    "Syn": "(sin3 * cos4 - cos3 * sin4) / Kn",
    "Pyn": "m00 * J2 / J3**3",
    # Names of Tahri and Chaumette 2005: c_i for the invariant C_i, and r1 and r2 for the invariants
    # that control the two tilt angles.
    **{f"c{k}": f"C{k} + 0" for k in range(1, 11)},
    "r1": "I13 / I15",
    "r2": "I14 / I15",
}

FORMULAS: dict[str, Formula] = {name: Formula(source) for name, source in _SOURCES.items()}

# Denominator of each feature. If it vanishes, the feature, and every formula that uses the feature,
# is undefined. degeneracy.py checks whether a denominator vanishes.
DENOMINATORS: dict[str, str] = {
    "alpha": "anisotropy",
    "alpha_full": "anisotropy",
    "C1": "anisotropy",
    **dict.fromkeys(("Sx", "Sy", "Sxn", "Syn"), "anisotropy"),
    "C2": "I4",
    **dict.fromkeys(("C3", "C4", "C5", "C6"), "I6"),
    **dict.fromkeys(("C7", "C8"), "I10"),
    **dict.fromkeys(("C9", "C10", "r1", "r2"), "I15"),
}
