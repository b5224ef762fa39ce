//! Parts of a page that a command writes: between `<!-- NAME: ... -->` and `<!-- end of NAME -->`.

use std::ops::Range;

/// Returns where the part stands, without the lines of its marks.
fn place(page: &str, name: &str) -> Option<Range<usize>> {
    let opens = page.find(&format!("<!-- {name}: "))?;
    let start = opens + page[opens..].find('\n')? + 1;
    let end = start + page[start..].find(&format!("<!-- end of {name} -->"))?;
    Some(start..end)
}

/// Returns the page with another part; nothing where the marks are missing.
pub(crate) fn replace(page: &str, name: &str, part: &str) -> Option<String> {
    let place = place(page, name)?;
    Some([&page[..place.start], part, &page[place.end..]].concat())
}

/// Returns the part; nothing where the marks are missing.
#[cfg(test)]
pub(crate) fn part<'a>(page: &'a str, name: &str) -> Option<&'a str> {
    place(page, name).map(|place| &page[place])
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAGE: &str = "before\n<!-- sums: by hand -->\nold\n<!-- end of sums -->\nafter\n";

    #[test]
    fn a_part_is_replaced_and_nothing_else() {
        let page = replace(PAGE, "sums", "new\nlines\n").unwrap();
        assert_eq!(page, PAGE.replace("old\n", "new\nlines\n"));
        assert_eq!(part(&page, "sums"), Some("new\nlines\n"));
    }

    #[test]
    fn a_page_without_the_marks_is_refused() {
        assert_eq!(replace(PAGE, "other", ""), None);
        assert_eq!(replace("<!-- sums: by hand -->\nold\n", "sums", ""), None);
    }
}
