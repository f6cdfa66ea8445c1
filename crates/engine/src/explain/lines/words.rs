//! Words of a line, and patterns over them.

/// The words of a text in one spelling: lower case, without signs, `WorkingCounter` as two words,
/// singular, one word for a SubDevice and for a working counter, umlauts as two letters.
pub(super) fn tokens(text: &str) -> Vec<String> {
    let mut parts: Vec<String> = Vec::new();
    for run in runs(&text.replace("(s)", "s")) {
        if run.chars().any(|c| c.is_ascii_digit()) {
            parts.push(run.to_lowercase());
        } else {
            parts.extend(humps(&run));
        }
    }
    let mut tokens: Vec<String> = Vec::with_capacity(parts.len());
    for part in parts {
        let word = singular(&part);
        match (tokens.last().map(String::as_str), word.as_str()) {
            (Some("sub"), "device") => *tokens.last_mut().expect("there is one") = "slave".into(),
            (_, "subdevice") => tokens.push("slave".into()),
            (_, "wkc" | "wc" | "wck" | "workcounter") => {
                tokens.extend(["working".into(), "counter".into()]);
            }
            _ => tokens.push(word),
        }
    }
    tokens
}

/// Runs of letters and digits; a minus sign belongs to a number that no letter precedes.
fn runs(text: &str) -> Vec<String> {
    let chars: Vec<char> = text.chars().collect();
    let mut runs: Vec<String> = Vec::new();
    let mut open = false;
    for (i, c) in chars.iter().enumerate() {
        let next = chars.get(i + 1).copied().unwrap_or(' ');
        let sign = *c == '-' && !open && next.is_ascii_digit();
        if c.is_alphanumeric() || sign {
            if !open {
                runs.push(String::new());
            }
            let run = runs.last_mut().expect("one was begun");
            match c {
                'ä' | 'Ä' => run.push_str("ae"),
                'ö' | 'Ö' => run.push_str("oe"),
                'ü' | 'Ü' => run.push_str("ue"),
                'ß' => run.push_str("ss"),
                c => run.push(*c),
            }
            open = true;
        } else {
            open = false;
        }
    }
    runs
}

/// The parts of `WorkingCounter` and `PLLError`, in lower case.
fn humps(run: &str) -> Vec<String> {
    let chars: Vec<char> = run.chars().collect();
    let mut parts = vec![String::new()];
    for (i, c) in chars.iter().enumerate() {
        let after_lower = i > 0 && chars[i - 1].is_lowercase();
        let before_lower = chars.get(i + 1).is_some_and(|next| next.is_lowercase());
        let after_upper = i > 0 && chars[i - 1].is_uppercase();
        let long_enough = chars.len() > i + 2;
        if c.is_uppercase() && (after_lower || after_upper && before_lower && long_enough) {
            parts.push(String::new());
        }
        parts.last_mut().expect("there is one").extend(c.to_lowercase());
    }
    parts
}

/// The word without a plural's `s`, and with `z` in words such as "synchronisation".
fn singular(word: &str) -> String {
    let word = word.replace("nchronis", "nchroniz");
    let keeps = word.len() < 4 || ["ss", "us", "is"].iter().any(|end| word.ends_with(end));
    match word.strip_suffix('s') {
        Some(singular) if !keeps => singular.to_owned(),
        _ => word,
    }
}

/// What a program prints: words, `#` for one word or number that varies, `*` for up to
/// [`GAP`] of them. Case, signs and blanks between words do not count.
pub(super) struct Pattern(Vec<Part>);

enum Part {
    Words(String),
    One,
    Gap,
}

/// The longest run of words that `*` stands for.
const GAP: usize = 12;

impl Pattern {
    pub fn new(print: &str) -> Self {
        let mut parts = Vec::new();
        for (i, gap) in print.split('*').enumerate() {
            if i > 0 {
                parts.push(Part::Gap);
            }
            for (j, words) in gap.split('#').enumerate() {
                if j > 0 {
                    parts.push(Part::One);
                }
                let words = tokens(words).concat();
                if !words.is_empty() {
                    parts.push(Part::Words(words));
                }
            }
        }
        Self(parts)
    }

    /// How many letters of the pattern stand in the line; `None` if it does not fit.
    pub fn fits(&self, line: &[String]) -> Option<usize> {
        let fits = (0..line.len()).any(|start| follows(&self.0, &line[start..]));
        let letters = |part: &Part| match part {
            Part::Words(words) => words.len(),
            Part::One | Part::Gap => 0,
        };
        let letters: usize = self.0.iter().map(letters).sum();
        (fits && letters > 0).then_some(letters)
    }
}

/// Whether the line begins with these parts.
fn follows(parts: &[Part], line: &[String]) -> bool {
    let Some((part, rest)) = parts.split_first() else { return true };
    match part {
        Part::One => line.split_first().is_some_and(|(_, line)| follows(rest, line)),
        Part::Gap => (0..=GAP.min(line.len())).any(|skip| follows(rest, &line[skip..])),
        Part::Words(words) => {
            let mut left = words.as_str();
            for (i, token) in line.iter().enumerate() {
                let Some(after) = left.strip_prefix(token.as_str()) else { return false };
                left = after;
                if left.is_empty() {
                    return follows(rest, &line[i + 1..]);
                }
            }
            false
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fits(print: &str, line: &str) -> bool {
        Pattern::new(print).fits(&tokens(line)).is_some()
    }

    #[test]
    fn words_in_one_spelling() {
        assert_eq!(
            tokens("WorkingCounter { expected: 3 }"),
            ["working", "counter", "expected", "3"]
        );
        assert_eq!(tokens("WKC -1"), ["working", "counter", "-1"]);
        assert_eq!(tokens("SubDevices: PLLError"), ["slave", "pll", "error"]);
        assert_eq!(tokens("0-3"), ["0", "3"]);
        assert_eq!(tokens("Zeitüberschreitung"), ["zeitueberschreitung"]);
        assert_eq!(tokens("Synchronisation status"), ["synchronization", "status"]);
    }

    #[test]
    fn holes_and_gaps() {
        assert!(fits("# datagrams UNMATCHED", "EtherCAT WARNING 0: 1 datagram UNMATCHED!"));
        assert!(!fits("# datagrams UNMATCHED", "UNMATCHED datagrams"));
        assert!(fits("out of sync", "Node OutOfSync"));
        assert!(fits("slave * lost", "slave 2 was lost"));
        assert!(!fits("slave lost", "slave 2 lost"));
        assert!(!fits("late", "translate"));
        assert!(!fits("", "anything"), "an empty pattern has no letters");
    }
}
