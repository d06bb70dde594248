//! Texts of files for a terminal, without control sequences.

use std::borrow::Cow;

/// The text with control characters written out, such as `\u{1b}`; a newline stays.
///
/// The name and the texts of a file may hold control sequences: they move a terminal's cursor, or change its title or
/// keys.
///
/// ```
/// assert_eq!(tcgs_core::printable("a\u{1b}[2J\u{7}b\n"), "a\\u{1b}[2J\\u{7}b\n");
/// assert_eq!(tcgs_core::printable("Zürich"), "Zürich");
/// ```
pub fn printable(text: &str) -> Cow<'_, str> {
    let is_control = |c: char| c.is_control() && c != '\n';
    if !text.contains(is_control) {
        return text.into();
    }
    let mut shown = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        if is_control(c) {
            shown.extend(c.escape_default());
        } else {
            shown.push(c);
        }
    }
    shown.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn control_characters_of_both_sets_are_written_out() {
        for c in ('\0'..='\u{ff}').filter(|c| c.is_control() && *c != '\n') {
            let shown = printable(&format!("a{c}b")).into_owned();
            assert!(shown.starts_with("a\\") && shown.ends_with('b') && !shown.contains(char::is_control), "{shown}");
        }
        assert_eq!(printable("\t\r\u{9b}1m"), "\\t\\r\\u{9b}1m");
        assert!(matches!(printable("two\nlines"), Cow::Borrowed("two\nlines")));
    }
}
