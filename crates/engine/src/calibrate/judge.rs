//! Finds the law of a follower: the likelihood of the measurement under each law, and the parameter
//! that fits best.

use isocat_esc::DriftLaw;
use isocat_sim::random::Stream;

use super::course::Course;
use super::likelihood::{Prediction, means};
use super::replay::{Known, Unknowns, predict, reading_variances, shown};

/// The fit of one law.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Fit {
    /// The law, with the parameter that fits best.
    pub law: DriftLaw,
    /// Root mean square of measured less predicted, in standard deviations.
    pub misfit: f64,
    /// Minus twice the logarithm of the likelihood, without a constant: the sum of those squares,
    /// plus a penalty for a law that predicts less sharply.
    pub unlikely: f64,
    /// The parameter as a real number, and its standard error: the phase, or the gain of
    /// `proportional`. `None` if the law does not fit, or if the parameter is beyond the tried
    /// range.
    pub parameter: Option<(f64, f64)>,
}

/// The result for a follower's law.
#[derive(Clone, PartialEq, Debug)]
pub enum Verdict {
    /// One law fits, and the others do not.
    Told(Fit),
    /// Several fit: the measurement cannot distinguish them.
    NotToldApart(Vec<Fit>),
    /// No law fits.
    NoneFits,
}

/// The judgement of a follower's law from its courses.
#[derive(Clone, PartialEq, Debug)]
pub struct Judgement {
    /// The verdict.
    pub verdict: Verdict,
    /// The best of each family, best first.
    pub fits: Vec<Fit>,
    /// Number of compared values.
    pub numbers: usize,
}

/// Compares what the courses show with the prediction of each law.
pub(super) fn judge(courses: &[Course], known: &[Known]) -> Judgement {
    let courses: Vec<Replayable<'_>> =
        courses.iter().zip(known).map(|(course, known)| Replayable::new(course, known)).collect();
    let mut rough: Vec<(Rough, &[DriftLaw])> =
        FAMILIES.iter().map(|family| (Rough::of(&courses, family), *family)).collect();
    rough.sort_by(|a, b| a.0.unlikely.total_cmp(&b.0.unlikely));
    let least = rough.first().map_or(0.0, |(rough, _)| rough.unlikely);
    let (near, far): (Vec<_>, Vec<_>) =
        rough.into_iter().partition(|(rough, _)| rough.unlikely - least < FAR);
    let mut fits: Vec<Fit> =
        near.iter().map(|(rough, family)| best(&courses, rough.at, family)).collect();
    // For a family that is far off, the shorter courses suffice to tell how much less likely it is.
    // They do not suffice to tell that nothing fits.
    let likeliest = fits.iter().map(|fit| fit.unlikely).fold(f64::INFINITY, f64::min);
    let any_fits = fits.iter().any(|fit| fit.misfit <= MOST_MISFIT);
    fits.extend(far.iter().map(|(rough, family)| match any_fits {
        true => Fit {
            law: family[rough.at],
            misfit: rough.misfit,
            unlikely: likeliest + rough.unlikely - least,
            parameter: None,
        },
        false => best(&courses, rough.at, family),
    }));
    fits.sort_by(|a, b| a.unlikely.total_cmp(&b.unlikely));
    let numbers = courses.iter().map(|course| course.shown.len()).sum();
    Judgement { verdict: verdict(&fits), fits, numbers }
}

/// The verdict of these fits, most likely first.
fn verdict(fits: &[Fit]) -> Verdict {
    let least = fits.first().map_or(0.0, |best| best.unlikely);
    let near = |fit: &&Fit| fit.misfit <= MOST_MISFIT && fit.unlikely - least < TOLD_APART;
    let fitting: Vec<Fit> = fits.iter().filter(near).copied().collect();
    match fitting.as_slice() {
        [] => Verdict::NoneFits,
        [one] => Verdict::Told(*one),
        _ => Verdict::NotToldApart(fitting),
    }
}

/// The best law of a family, searched from index `at`.
fn best(courses: &[Replayable<'_>], mut at: usize, family: &[DriftLaw]) -> Fit {
    let mut here = Replayed::new(courses, family[at]);
    // The search climbs to the most likely law. A law that does not fit says little of its
    // neighbours, so they are replayed in full.
    let beside = loop {
        let beside = [at.checked_sub(1), Some(at + 1).filter(|next| *next < family.len())];
        let beside = beside.map(|next| Some((next?, here.beside(courses, family[next?]))));
        let better = beside
            .iter()
            .flatten()
            .filter(|(_, it)| it.unlikely < here.unlikely || here.misfit > MOST_MISFIT)
            .map(|(next, _)| (*next, Replayed::new(courses, family[*next])))
            .min_by(|(_, a), (_, b)| a.unlikely.total_cmp(&b.unlikely));
        match better {
            Some((next, there)) if there.unlikely < here.unlikely => (at, here) = (next, there),
            _ => break beside,
        }
    };
    let [below, above] = beside.map(|beside| beside.map(|(_, it)| it));
    let fits = here.misfit <= MOST_MISFIT;
    let parameter = below.zip(above).filter(|_| fits).map(|(below, above)| {
        let (steps, error) = here.refine(&below, &above);
        // If the fit is worse than chance explains, the parameter is less exact, too.
        let error = (error * here.misfit.max(1.0)).hypot(LEAST_ERROR);
        match family[at] {
            DriftLaw::Hold { phase } | DriftLaw::Block { phase } => {
                (f64::from(phase) + steps, error)
            }
            // Gains double from one law to the next.
            DriftLaw::Proportional { gain, .. } => {
                let gain = f64::from(gain) * steps.exp2();
                (gain, gain * std::f64::consts::LN_2 * error)
            }
        }
    });
    Fit { law: family[at], misfit: here.misfit, unlikely: here.unlikely, parameter }
}

/// A course of one follower, with draws of the unknown quantities. The draws are the same for each
/// law, so that only the laws differ.
struct Replayable<'a> {
    course: &'a Course,
    shown: Vec<f64>,
    readings: Vec<f64>,
    draws: Vec<Unknowns>,
}

impl<'a> Replayable<'a> {
    fn new(course: &'a Course, known: &Known) -> Self {
        let draw =
            |number| Unknowns::draw(course, known, &mut Stream::new(SEED, "calibrate", number));
        Self {
            course,
            shown: shown(course, known.follower),
            readings: reading_variances(course, known.follower),
            draws: (0..DRAWS).map(draw).collect(),
        }
    }

    /// The prediction of a law with the first `draws` draws.
    fn predicted(&self, law: DriftLaw, draws: usize) -> Vec<Vec<f64>> {
        self.draws[..draws].iter().map(|draw| predict(self.course, law, draw)).collect()
    }
}

/// The best law of a family by the shorter courses and few draws.
struct Rough {
    at: usize,
    unlikely: f64,
    misfit: f64,
}

impl Rough {
    fn of(courses: &[Replayable<'_>], family: &[DriftLaw]) -> Self {
        let one = |(at, law): (usize, &DriftLaw)| {
            let (mut square, mut breadth, mut numbers) = (0.0, 0.0, 0);
            for course in courses.iter().filter(|course| course.course.frames.len() <= SHORT) {
                let drawn = course.predicted(*law, ROUGH_DRAWS);
                let predicted = Prediction::of(&drawn, &course.readings, false);
                square += squares(&predicted.rests(&course.shown));
                breadth += predicted.breadth();
                numbers += course.shown.len();
            }
            let misfit = (square / numbers.max(1) as f64).sqrt();
            Self { at, unlikely: square + breadth, misfit }
        };
        let each = family.iter().enumerate().map(one);
        let none = Self { at: 0, unlikely: f64::INFINITY, misfit: f64::INFINITY };
        each.min_by(|a, b| a.unlikely.total_cmp(&b.unlikely)).unwrap_or(none)
    }
}

/// All courses of one follower under one law.
struct Replayed {
    each: Vec<Compared>,
    unlikely: f64,
    misfit: f64,
}

/// One course under one law.
struct Compared {
    prediction: Prediction,
    rests: Vec<f64>,
    /// The means of the few draws that neighbours use.
    few: Vec<f64>,
}

/// A law next to one that was replayed.
struct Beside {
    /// Means of few draws, of each course.
    few: Vec<Vec<f64>>,
    /// Its `unlikely` if its errors are those of the replayed law.
    unlikely: f64,
}

impl Replayed {
    fn new(courses: &[Replayable<'_>], law: DriftLaw) -> Self {
        let (mut square, mut breadth, mut numbers) = (0.0, 0.0, 0);
        let each = courses.iter().map(|course| {
            let drawn = course.predicted(law, DRAWS as usize);
            let prediction = Prediction::of(&drawn, &course.readings, true);
            let rests = prediction.rests(&course.shown);
            square += squares(&rests);
            breadth += prediction.breadth();
            numbers += rests.len();
            Compared { prediction, rests, few: means(&drawn[..FEW_DRAWS]) }
        });
        let each = each.collect();
        let misfit = (square / numbers.max(1) as f64).sqrt();
        Self { each, unlikely: square + breadth, misfit }
    }

    /// A law next to this one, from the change over few of the same draws.
    fn beside(&self, courses: &[Replayable<'_>], law: DriftLaw) -> Beside {
        let few: Vec<Vec<f64>> =
            courses.iter().map(|course| means(&course.predicted(law, FEW_DRAWS))).collect();
        let mut unlikely = self.unlikely;
        for (here, few) in self.each.iter().zip(&few) {
            let change = here.prediction.change(&here.few, few);
            let rests = here.rests.iter().zip(&change).map(|(rest, change)| rest - change);
            unlikely += squares(&rests.collect::<Vec<f64>>()) - squares(&here.rests);
        }
        Beside { few, unlikely }
    }

    /// The place between the neighbours where the parameter fits best, in steps from here, and the
    /// standard error: one step of least squares.
    fn refine(&self, below: &Beside, above: &Beside) -> (f64, f64) {
        let (mut product, mut square) = (0.0, 0.0);
        for (here, (below, above)) in self.each.iter().zip(below.few.iter().zip(&above.few)) {
            // The effect halves with each step of the exponent, so the nearer slope is the mean of
            // both sides.
            let slope = here.prediction.change(below, above);
            let rests = slope.iter().zip(&here.rests);
            product += rests.map(|(slope, rest)| slope / 2.0 * rest).sum::<f64>();
            square += squares(&slope) / 4.0;
        }
        match square > 0.0 {
            true => (product / square, 1.0 / square.sqrt()),
            false => (0.0, f64::INFINITY),
        }
    }
}

fn squares(rests: &[f64]) -> f64 {
    rests.iter().map(|rest| rest * rest).sum()
}

const fn hold(phase: u8) -> DriftLaw {
    DriftLaw::Hold { phase }
}

const fn block(phase: u8) -> DriftLaw {
    DriftLaw::Block { phase }
}

const fn proportional(gain: u16) -> DriftLaw {
    DriftLaw::Proportional { gain, limit: 1_000 }
}

/// The laws that are tried, by family, each with its parameter in order: those of the public
/// record, and some more on both sides.
const FAMILIES: [&[DriftLaw]; 3] = [
    &[hold(6), hold(7), hold(8), hold(9), hold(10), hold(11), hold(12), hold(13), hold(14)],
    &[
        block(6),
        block(7),
        block(8),
        block(9),
        block(10),
        block(11),
        block(12),
        block(13),
        block(14),
    ],
    &[proportional(1), proportional(2), proportional(4), proportional(8), proportional(16)],
];
/// A law fits up to this misfit, in standard deviations.
pub const MOST_MISFIT: f64 = 3.0;
/// Laws are distinguished by this difference of likelihood: five standard deviations.
pub const TOLD_APART: f64 = 25.0;
/// Lower bound of the exponent's error, however good the figures are: the rounding of a step.
const LEAST_ERROR: f64 = 0.0005;
/// Numbers of draws of the unknown quantities: for a first look, for neighbours, and for the
/// figures.
const ROUGH_DRAWS: usize = 6;
const FEW_DRAWS: usize = 10;
const DRAWS: u64 = 40;
/// Drift frames of a course in the first look.
const SHORT: usize = 300;
/// A family is skipped after the first look if it is this much less likely than another one: thirty
/// standard deviations.
const FAR: f64 = 900.0;
/// The draws are the same in each judgement.
const SEED: u64 = 1;

#[cfg(test)]
mod tests {
    use super::*;

    fn fit(law: DriftLaw, misfit: f64, unlikely: f64) -> Fit {
        Fit { law, misfit, unlikely, parameter: None }
    }

    /// Both sides of both limits.
    #[test]
    fn one_several_or_none_fit() {
        let told = |fits: [Fit; 2]| match verdict(&fits) {
            Verdict::Told(_) => 1,
            Verdict::NotToldApart(several) => several.len(),
            Verdict::NoneFits => 0,
        };
        let pair =
            |a: (f64, f64), b: (f64, f64)| [fit(hold(10), a.0, a.1), fit(block(9), b.0, b.1)];
        assert_eq!(told(pair((1.0, 50.0), (1.2, 75.0))), 1);
        assert_eq!(told(pair((1.0, 50.0), (1.2, 74.9))), 2);
        assert_eq!(told(pair((2.9, 410.0), (3.01, 420.0))), 1);
        assert_eq!(told(pair((3.0, 410.0), (3.01, 420.0))), 1);
        assert_eq!(told(pair((3.01, 420.0), (3.02, 425.0))), 0);
    }
}
