"""Whether a step that failed was failed by the machine, which came too late, or by the served segment.

Only evidence counts: a failure is lateness if it is of a kind that late frames can make, and the witness saw stalls at the time, long
enough for it. All else is a failure of what is tested, on however busy a machine.
"""
import re

# How long after a stall it may still be the cause of an AL status: devices count, wait and ask before they fall.
REACH = 1.0
# Stalls within so many cycles add up: two frames that are late, one behind the other, are two missed SM events.
CLOSE = 4
# Cycles that a drive is away once it fell.
AWAY = 400
# A stall spoils up to so many times the cycles that it takes: frames that waited come at once, and some take each other's place.
SPREAD = 4
# AL status codes that say that frames or SYNC0 did not come in time: sync manager watchdog, synchronization error, fatal sync error,
# no sync error, PLL error, DC sync timeout.
TIMELY = {0x001A, 0x001B, 0x002C, 0x002D, 0x0032, 0x0033, 0x0034}
# How long each MainDevice waits for a frame or a message at the least, in seconds.
PATIENCE = {"kickcat": 0.010, "pysoem": 0.020, "ethercrab": 0.200}

DATA = re.compile(r"torn [1-9]|0x[0-9A-F]{4}:[0-9A-F]{2} is|0x[0-9A-F]{4}:[0-9A-F]{2}: .*, not |\bbytes\b.*, not |length of|exit code")
STATE = re.compile(r"^not in |^not all in OP|wait_for_state|state transition", re.IGNORECASE)
RHYTHM = re.compile(r"\d+ cycles, \d+ with a wrong working counter")
# What KickCAT says of a frame that did not come back in time says what it was doing: "error while checking mailboxes".
FRAME = re.compile(r"time-?d? ?-?out|took too long|no frame|WkcError|working counter|(Bus|CoE)\.cc:\d+: (init )?error while ", re.IGNORECASE)


def kind(what):
    """What a step says of its failure, as a kind: data, rhythm, state, frame, other."""
    for name, words in [("data", DATA), ("rhythm", RHYTHM), ("state", STATE), ("frame", FRAME)]:
        if words.search(what):
            return name
    return "other"


def lateness(peer, failure, stalls, refusals, cycle, drives):
    """Why the failure is lateness of the machine, in words, or None if it is not.

    `failure` is (what, begin, end), `stalls` are pairs (begin, length), `refusals` pairs (time, AL status code) of the SubDevices; all
    times in seconds on one clock. `cycle` is the cycle in seconds, `drives` whether there are SubDevices that leave OP for late frames."""
    what, begin, end = failure
    during = [(at, length) for at, length in stalls if at + length >= begin and at <= end]
    longest = max((length for _, length in during), default=0.0)
    # SubDevices that fell, and whether the machine had stalled before each.
    fell = [(at, code) for at, code in refusals if begin - REACH <= at <= end + REACH]
    timely = all(code in TIMELY and stalled_before(at, stalls, cycle) for at, code in fell)
    match kind(what):
        case "frame":
            if longest >= PATIENCE[peer] / 2:
                return f"the machine stalled for {longest * 1e3:.0f} ms"
        case "state":
            if fell and timely:
                codes = ", ".join(sorted({f"0x{code:04X}" for _, code in fell}))
                return f"AL status {codes}, each after a stall of a cycle or more"
        case "rhythm" if timely:
            away = AWAY if drives and fell else 0
            struck = sum(took / cycle + away for took in together(during, cycle))
            if struck >= spoiled(what) / SPREAD:
                return f"stalls took {struck:.0f} cycles"
    return None


def spoiled(what):
    """Cycles without good process data, by the worst SubDevice."""
    cycles, wrong = (int(number) for number in re.match(r"(\d+) cycles, (\d+) with", what).groups())
    return max(1, wrong, *(cycles - int(number) for number in re.findall(r"(?:moved|enabled) (\d+)", what)))


def stalled_before(at, stalls, cycle):
    """Whether the machine stalled for a cycle in all, at most `CLOSE` cycles from the first stall to the last, and not long before."""
    near = [(begin, begin + length) for begin, length in stalls if begin <= at and at - (begin + length) <= REACH]
    return any(covered([stall for stall in near if 0 <= stall[0] - first <= CLOSE * cycle + 1e-9]) >= cycle for first, _ in near)


def together(stalls, cycle):
    """How long each group of stalls took that lie within `CLOSE` cycles, if a cycle or more."""
    groups = []
    for begin, length in sorted(stalls):
        if groups and begin - groups[-1][0][0] <= CLOSE * cycle + 1e-9:
            groups[-1].append((begin, begin + length))
        else:
            groups.append([(begin, begin + length)])
    return [took for took in map(covered, groups) if took >= cycle]


def late_requests(frames, cycle):
    """Stalls of the MainDevice's side, from a capture of its own interface: `frames` are pairs (time, whether it is an answer).

    Only a request that left late though its predecessor had been answered counts: between a request and its answer the segment
    has to do, and what it does wrongly there is no lateness of the machine."""
    late = []
    for (before, answered), (now, answer) in zip(frames, frames[1:]):
        if answered and not answer and now - before > 2 * cycle:
            late.append((before + cycle, now - before - cycle))
    return late


def covered(spans):
    """What spans (begin, end) take together; each processor may have seen the same stall."""
    total, until = 0.0, float("-inf")
    for begin, end in sorted(spans):
        total += max(0.0, end - max(begin, until))
        until = max(until, end)
    # Clocks have more digits than differences of them.
    return round(total, 9)
