//! Equal devices side by side, told as one: thirty terminals are one row of a table and not thirty.

/// Fewer neighbours than this are told one by one: two axes are not worth a range.
pub const LEAST: usize = 3;

/// Divides `all` into stretches, in order: neighbours that are all the same as the first of them,
/// if there are [`LEAST`] or more, and else single ones.
pub fn fold<T>(all: &[T], same: impl Fn(&T, &T) -> bool) -> Vec<&[T]> {
    let mut stretches = Vec::new();
    let mut rest = all;
    while let Some(first) = rest.first() {
        let equal = rest.iter().take_while(|one| same(first, one)).count().max(1);
        let (stretch, behind) = rest.split_at(equal);
        match stretch.len() < LEAST {
            true => stretches.extend(stretch.chunks(1)),
            false => stretches.push(stretch),
        }
        rest = behind;
    }
    stretches
}

/// `3`, or `3 to 14`.
pub fn range(first: usize, last: usize) -> String {
    if first == last { first.to_string() } else { format!("{first} to {last}") }
}

/// Places in a list of positions.
const MOST_PLACES: usize = 12;

/// Ascending positions: `1, 3 to 5, 9`. Two neighbours stand one by one; a list longer than
/// `MOST_PLACES` ends with a count.
pub fn positions(all: &[usize]) -> String {
    let numbered: Vec<(usize, usize)> = all.iter().copied().enumerate().collect();
    // In a row of neighbours place and position go up together.
    let stretches = fold(&numbered, |(i, a), (j, b)| b - a == j - i);
    let word = |stretch: &&[(usize, usize)]| range(stretch[0].1, stretch[stretch.len() - 1].1);
    let words: Vec<String> = stretches.iter().take(MOST_PLACES).map(word).collect();
    let more: usize = stretches.iter().skip(MOST_PLACES).map(|stretch| stretch.len()).sum();
    match more {
        0 => words.join(", "),
        more => format!("{} and {more} more", words.join(", ")),
    }
}

/// One name for several devices: `io 0..11` where they are numbered, `gripper` where all are called
/// so, else the first and the last.
pub fn name(names: &[&str]) -> String {
    let (Some(first), Some(last)) = (names.first(), names.last()) else { return String::new() };
    if names.iter().all(|name| name == first) {
        return (*first).to_owned();
    }
    let (stem, from) = numbered(first);
    let counts = |(i, name): (usize, &&str)| {
        let (own, number) = numbered(name);
        own == stem && number.zip(from).is_some_and(|(number, from)| number == from + i as u64)
    };
    match names.iter().enumerate().all(counts) {
        true => format!("{first}..{}", &last[stem.len()..]),
        false => format!("{first} .. {last}"),
    }
}

/// A name without the number at its end, and that number.
fn numbered(name: &str) -> (&str, Option<u64>) {
    let stem = name.trim_end_matches(|c: char| c.is_ascii_digit());
    (stem, name[stem.len()..].parse().ok())
}

/// Place and name of one device or of several, in columns of `places` and `columns` characters with
/// a space between: `3   axis 1`, `3 to 14  io 0..11 (12)`. A range takes what it needs of the
/// column of names.
pub fn label(devices: &[(usize, &str)], places: usize, columns: usize) -> String {
    use isocat_descriptions::columns::cut;
    let (Some(first), Some(last)) = (devices.first(), devices.last()) else { return String::new() };
    if devices.len() == 1 {
        return format!("{:<places$} {:<columns$}", first.0, cut(first.1, columns));
    }
    let names: Vec<&str> = devices.iter().map(|(_, name)| *name).collect();
    let place = range(first.0, last.0);
    let width = places + 1 + columns;
    let room = width.saturating_sub(place.chars().count() + 2).max(4);
    let (name, count) = (name(&names), format!(" ({})", devices.len()));
    // The count is known by the places, too: it goes first where there is no room.
    let name = match name.chars().count() + count.chars().count() <= room {
        true => name + &count,
        false => cut(&name, room),
    };
    format!("{:<width$}", format!("{place}  {name}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_equal_neighbours_stand_together_and_two_do_not() {
        let of = |text: &str| {
            let all: Vec<char> = text.chars().collect();
            let stretches = fold(&all, |a, b| a == b);
            stretches.iter().map(|s| s.len().to_string()).collect::<Vec<_>>().join(" ")
        };
        assert_eq!(of(""), "");
        assert_eq!(of("aab"), "1 1 1");
        assert_eq!(of("aaab"), "3 1");
        assert_eq!(of("baaa"), "1 3");
        assert_eq!(of("aaaabbbcc"), "4 3 1 1");
        assert_eq!(of("abab"), "1 1 1 1");
    }

    #[test]
    fn positions_are_ranges_from_three_on() {
        assert_eq!(positions(&[]), "");
        assert_eq!(positions(&[4]), "4");
        assert_eq!(positions(&[1, 2]), "1, 2");
        assert_eq!(positions(&[1, 3, 4, 5, 9]), "1, 3 to 5, 9");
        assert_eq!(positions(&[0, 1, 2, 4, 6, 7, 8, 9]), "0 to 2, 4, 6 to 9");
        let odd = |count: usize| (0..count).map(|i| 2 * i + 1).collect::<Vec<_>>();
        assert_eq!(positions(&odd(12)), "1, 3, 5, 7, 9, 11, 13, 15, 17, 19, 21, 23");
        assert_eq!(positions(&odd(14)), "1, 3, 5, 7, 9, 11, 13, 15, 17, 19, 21, 23 and 2 more");
    }

    #[test]
    fn numbered_names_are_a_range() {
        assert_eq!(name(&["io 0", "io 1", "io 2"]), "io 0..2");
        assert_eq!(name(&["io 9", "io 10", "io 11"]), "io 9..11");
        // One is missing: the range would promise it.
        assert_eq!(name(&["io 0", "io 2", "io 3"]), "io 0 .. io 3");
        assert_eq!(name(&["x", "y", "z"]), "x .. z");
        assert_eq!(name(&["7", "8", "9"]), "7..9");
        assert_eq!(name(&["same", "same", "same"]), "same");
        assert_eq!(name(&["99999999999999999999", "b", "c"]), "99999999999999999999 .. c");
    }

    #[test]
    fn labels_keep_their_columns() {
        let io: Vec<String> = (0..1000).map(|i| format!("io {i}")).collect();
        let all = |from: usize, count: usize| -> Vec<(usize, &str)> {
            (from..).zip(&io[..count]).map(|(at, name)| (at, name.as_str())).collect()
        };
        assert_eq!(label(&all(3, 1), 2, 19), "3  io 0               ");
        assert_eq!(label(&all(3, 12), 2, 19), "3 to 14  io 0..11 (12)");
        assert_eq!(label(&all(10, 1000), 2, 19), "10 to 1009  io 0..999 ");
        for count in 1..1000 {
            assert_eq!(label(&all(count, count), 2, 19).chars().count(), 22, "{count}");
        }
    }
}
