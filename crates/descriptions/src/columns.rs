//! Text in the columns of a terminal: lines that break at spaces, and words that are cut.

/// Breaks `text` into lines of `width` characters at most, at spaces; a word longer than the width
/// stays whole.
pub fn wrap(text: &str, width: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if line.chars().count() + 1 + word.chars().count() <= width => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

/// Keeps the last `columns` characters, so that a path keeps its file name.
pub fn cut_front(text: &str, columns: usize) -> String {
    let all = text.chars().count();
    if all <= columns {
        return text.to_owned();
    }
    std::iter::once('…').chain(text.chars().skip(all - columns + 1)).collect()
}

/// Keeps the first `columns` characters, with an ellipsis for the rest.
pub fn cut(text: &str, columns: usize) -> String {
    if text.chars().count() <= columns {
        return text.to_owned();
    }
    text.chars().take(columns - 1).chain(['…']).collect()
}

/// Removes styles: everything between ESC and `m` is left out.
pub fn plain(text: &str) -> String {
    let mut parts = text.split('\u{1b}');
    let first = parts.next().unwrap_or_default().to_owned();
    parts.fold(first, |all, part| all + part.split_once('m').map_or(part, |(_, rest)| rest))
}

/// Width of isocat's texts, in columns.
pub const WIDTH: usize = 100;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_sentences_break_at_spaces() {
        assert_eq!(wrap("one two three", 7), ["one two", "three"]);
        assert_eq!(wrap("", 7), Vec::<String>::new());
        assert_eq!(cut("abcdef", 4), "abc…");
    }

    #[test]
    fn a_long_path_keeps_its_end() {
        assert_eq!(cut_front("a/b.toml", 8), "a/b.toml");
        assert_eq!(cut_front("/a/b.toml", 8), "…/b.toml");
    }
}
