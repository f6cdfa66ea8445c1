#!/usr/bin/env python3
"""The judge of foreign MainDevices, at its edges: python3 tests/interop/verdict_test.py"""
import unittest

from verdict import kind, late_requests, lateness

CYCLE = 0.001


def judge(what, stalls=(), refusals=(), peer="pysoem", drives=False):
    return lateness(peer, (what, 100.0, 105.0), list(stalls), list(refusals), CYCLE, drives)


class Kinds(unittest.TestCase):
    def test_what_the_steps_say(self):
        for what, wanted in [
            ("0x1C32:05: 7, not 100000", "data"),
            ("length of A: 0x1C32:05: 2, not 4", "data"),
            ("A 0, bytes: (2, 2), not (16, 16)", "data"),
            ("A: 0x1C32:05 is 7, not Some(100000)", "data"),
            ("5000 cycles, 0 with a wrong working counter; longest 2 ms; A: torn 1, moved 5000, lag 3", "data"),
            ("exit code -11", "data"),
            ("5000 cycles, 900 with a wrong working counter; longest 20 ms; ", "rhythm"),
            ("5000 cycles, 0 with a wrong working counter; longest 2 ms; A: torn 0, moved 3, lag 3", "rhythm"),
            ("not in OP: A 0x14/0x001a", "state"),
            ("not all in OP after 10 s", "state"),
            ("RuntimeError: Timeout", "frame"),
            ("took too long", "frame"),
            ("RuntimeError: CoE.cc:13: error while checking mailboxes", "frame"),
            ("A: 0x1C32:05: timeout: PDU [exit]", "frame"),
            ("SubDevices: 3, not 4", "other"),
            ("isocat serve ended with 101", "other"),
        ]:
            self.assertEqual(kind(what), wanted, what)


class Verdicts(unittest.TestCase):
    def test_wrong_data_is_never_lateness(self):
        for what in ["0x1C32:05: 7, not 100000", "exit code 3", "SubDevices: 3, not 4", "something new"]:
            self.assertIsNone(judge(what, [(101.0, 3.0)]), what)

    def test_a_frame_is_late_only_with_a_stall_in_the_step(self):
        self.assertIsNone(judge("Timeout"))
        self.assertIsNone(judge("Timeout", [(101.0, 0.0099)]))
        self.assertIsNone(judge("Timeout", [(98.0, 1.0), (105.1, 1.0)]))
        self.assertIn("stalled", judge("Timeout", [(101.0, 0.010)]))
        self.assertIn("stalled", judge("Timeout", [(99.5, 0.6)]))

    def test_patience_differs(self):
        self.assertIsNone(judge("Timeout", [(101.0, 0.099)], peer="ethercrab"))
        self.assertIn("stalled", judge("Timeout", [(101.0, 0.1)], peer="ethercrab"))
        self.assertIn("stalled", judge("Timeout", [(101.0, 0.005)], peer="kickcat"))

    def test_never_reaching_op_is_no_lateness(self):
        stalls = [(101.0, 0.5)]
        self.assertIsNone(judge("not in OP: A 0x4/0x0000", stalls))
        self.assertIsNone(judge("not in OP: A 0x14/0x0001", stalls, [(101.6, 0x0001)]))
        self.assertIsNone(judge("not in OP: A 0x14/0x001a", [], [(101.6, 0x001A)]))
        # One that fell without a stall before it is enough.
        self.assertIsNone(judge("not in OP: A 0x14/0x001a", stalls, [(101.6, 0x001A), (104.0, 0x001A)]))

    def test_a_fall_after_a_stall_of_a_cycle_is(self):
        said = "not in OP: A 0x14/0x001a"
        self.assertIn("0x001A", judge(said, [(101.0, CYCLE)], [(101.6, 0x001A)]))
        self.assertIsNone(judge(said, [(101.0, CYCLE * 0.99)], [(101.6, 0x001A)]))
        self.assertIsNone(judge(said, [(101.0, CYCLE)], [(102.1, 0x001A)]))

    def test_short_stalls_that_lie_close_together_add_up(self):
        said, fell = "not in OP: A 0x14/0x001a", [(101.6, 0x001A)]
        half = CYCLE / 2
        self.assertIn("0x001A", judge(said, [(101.0, half), (101.0 + 4 * CYCLE, half)], fell))
        self.assertIsNone(judge(said, [(101.0, half), (101.0 + 4.01 * CYCLE, half)], fell))
        self.assertIsNone(judge(said, [(101.0, half), (101.0 + 2 * CYCLE, half * 0.99)], fell))
        # Both processors saw the same one.
        self.assertIsNone(judge(said, [(101.0, half), (101.0, half)], fell))

    def test_rhythm_needs_stalls_for_a_quarter_of_what_is_spoiled(self):
        for said in ["5000 cycles, 200 with a wrong working counter; longest 20 ms; ",
                     "5000 cycles, 0 with a wrong working counter; longest 20 ms; A: torn 0, moved 4800, lag 3; B: torn 0, moved 4999, lag 101"]:
            self.assertIsNone(judge(said))
            self.assertIsNone(judge(said, [(101.0 + n, 0.012) for n in range(4)]))
            self.assertIn("stalls", judge(said, [(101.0 + n, 0.0126) for n in range(4)]))
            # Shorter than a cycle: the frame still comes in it.
            self.assertIsNone(judge(said, [(101.0 + n / 100, 0.0009) for n in range(100)]))

    def test_a_drive_that_falls_after_a_stall_is_away_for_long(self):
        said = "5000 cycles, 0 with a wrong working counter; longest 9 ms; A: enabled 2900, behind 10, status 0x0627"
        stalls, falls = [(101.0, 0.002), (102.0, 0.002)], [(101.1, 0x001A), (102.1, 0x001A)]
        self.assertIn("stalls", judge(said, stalls, falls, drives=True))
        self.assertIsNone(judge(said, stalls[:1], falls[:1], drives=True))
        self.assertIsNone(judge(said, stalls, falls))
        # It did not fall, fell for another reason, or fell once without a stall.
        self.assertIsNone(judge(said, stalls, drives=True))
        self.assertIsNone(judge(said, stalls, [falls[0], (102.1, 0x001D)], drives=True))
        self.assertIsNone(judge(said, stalls, [*falls, (104.0, 0x001A)], drives=True))

    def test_short_stalls_together_keep_a_drive_away_too(self):
        said = "1500 cycles, 0 with a wrong working counter; longest 9 ms; A: enabled 800, behind 10, status 0x0627"
        half, falls = CYCLE / 2, [(101.1, 0x001A)]
        self.assertIn("stalls", judge(said, [(101.0, half), (101.002, half)], falls, drives=True))
        self.assertIsNone(judge(said, [(101.0, half), (101.002, half * 0.99)], falls, drives=True))

    def test_a_request_is_late_only_behind_an_answer(self):
        def late(gap, *, answered):
            frames = [(100.0, False), (100.0001, True)] if answered else [(100.0001, False)]
            return late_requests([*frames, (100.0001 + gap, False), (100.0002 + gap, True)], CYCLE)

        [(at, length)] = late(2.1 * CYCLE, answered=True)
        self.assertAlmostEqual(at, 100.0001 + CYCLE)
        self.assertAlmostEqual(length, 1.1 * CYCLE)
        self.assertEqual(late(1.9 * CYCLE, answered=True), [])
        # The segment did not answer: that is its fault.
        self.assertEqual(late(50 * CYCLE, answered=False), [])


if __name__ == "__main__":
    unittest.main()
