"""Every tolerance and every target of the comparison, each with its reason."""

from dataclasses import dataclass

# --- when a position counts -----------------------------------------------------------------------------------------
# A body that has left the picture only falls on and magnifies old differences, and no outcome depends on it.
IN_PLAY_MAX_Y = 620.0  # px: a bar's thickness below the goal line at y = 600
IN_PLAY_CENTRE_X = 300.0  # px: the middle of the 600 px picture
IN_PLAY_MAX_DX = 400.0  # px: 100 px beyond either side of the picture

# --- the shares that are reported, px -------------------------------------------------------------------------------
SHARE_LIMITS = (1e-9, 1e-6, 1e-3, 1.0)

# --- float64, whole games -------------------------------------------------------------------------------------------
# Every operation rounds as the reference's, so a play is equal bit for bit; sine, cosine and the exponentials of the
# host's library are the only places where another machine may differ in a last bit. Where that is not amplified by a
# knife edge it stays below 1e-9 px.
EXACT_ERROR = 1e-6  # px
TIGHT_ERROR = 1e-9  # px


@dataclass(frozen=True)
class Target:
    """What one table (one frame rate, one type) must reach.

    Attributes:
        error: px, the error a plan must stay within to count.
        share: share of all plans within `error`, in [0, 1].
        game_share: share of every single game's plans within `error`.
        flag: share of plans with the same success flag.
        step: share of plans with the same success step.
        tight: share of plans within `TIGHT_ERROR`.
        identical: share of plans equal bit for bit.
    """

    error: float
    share: float
    game_share: float
    flag: float
    step: float
    tight: float = 0.0
    identical: float = 0.0


# In float32 a last bit is 6e-5 px, which every bounce magnifies; these shares are about what the reference itself
# reaches when it is compiled in float32.
FLOAT32_FLAG = 0.995

TARGETS: dict[tuple[str, int], Target] = {
    ("float64", 60): Target(EXACT_ERROR, 0.999, 0.95, 1.0, 1.0, tight=0.995, identical=0.6),
    ("float64", 10): Target(EXACT_ERROR, 0.999, 0.95, 1.0, 1.0, tight=0.995, identical=0.6),
    ("float32", 60): Target(1.0, 0.88, 0.0, FLOAT32_FLAG, 0.97),
    ("float32", 10): Target(1.0, 0.95, 0.0, FLOAT32_FLAG, 0.995),
}

# --- float64, random scenes -----------------------------------------------------------------------------------------
# Exactly touching and exactly symmetric starts stand on knife edges: the reference rebuilt with fused multiply-adds
# agrees with itself in 95 to 96 % of such plays.
RANDOM_SHARE = 0.98
RANDOM_STEP = 0.998

# --- float64, stage by stage ----------------------------------------------------------------------------------------
# One step from the reference's own state: what is left is the order of a few roundings. The unit is that of the
# quantity (px, px/s, impulse per unit mass); values reach 1e3, so 1e-9 is some 1e4 roundings.
STAGE_POSITION = 1e-9  # px and rad
STAGE_NORMAL = 1e-9  # unit vectors
STAGE_POINT = 1e-9  # px
STAGE_MASS = 1e-9  # relative
STAGE_SPEED = 1e-8  # px/s: bias speed divides an overlap by dt, bounce multiplies a spin by an arm of 100 px
STAGE_IMPULSE = 1e-7  # ten sweeps over stacked contacts magnify the roundings of masses and speeds
STAGE_VELOCITY = 1e-7  # px/s and rad/s, from those impulses; a bar's inverse moment times its arm is about 1

# --- the sample in the test suite -----------------------------------------------------------------------------------
# 30 to 90 plays: too few for the targets' last percent, so a play on a knife edge may stray (float64), and float32 may
# miss its share by its own spread (three standard deviations of 60 plays at 0.9).
SAMPLE_SHARES = {"float64": 0.96, "float32": 0.78}
SAMPLE_FLOAT32_FLAG = 0.98  # one play in 60 may end otherwise

# The golden files: so many of their plays must be equal bit for bit where this is written (x86-64, jaxlib 0.10.2).
# Another processor's or compiler's sine, cosine or rounding may differ, which costs bits but not the 1e-6 px.
GOLDEN_IDENTICAL = 0.9

# Observations of the environments, lengths being divided by 600 px: float32 resolves 6e-8 there, and in float64 the
# poses agree to 1e-6 px.
OBSERVATION = 1e-6

# Pictures of the starts, shares of pixels of another colour. Our edges are anti-aliased, the official ones are not;
# away from edges and marks there are springs, whose zigzag differs, and slanted bars, which pygame draws thinner.
PICTURE_ALL = 0.01
PICTURE_INNER = 0.001
