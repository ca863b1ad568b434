//! Pages of the documentation with sections that the code's own tables write.

/// Holds each section of a page, from `<!-- NAME: generated -->` to the next marker, against its content; with `UPDATE_DOCS`
/// set it writes them. `tests` are the arguments of `cargo test` by which that is done.
pub fn holds(path: &str, sections: &[(&str, String)], tests: &str) {
    let page = std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{path}: {e}"));
    let mut expected = page.clone();
    for (name, content) in sections {
        let begin = format!("<!-- {name}: generated -->\n");
        let (head, rest) = expected
            .split_once(&begin)
            .unwrap_or_else(|| panic!("{path} lacks {begin}"));
        let (_, tail) = rest
            .split_once("<!-- ")
            .unwrap_or_else(|| panic!("{path}: {name} has no end"));
        expected = format!("{head}{begin}{content}<!-- {tail}");
    }
    if std::env::var_os("UPDATE_DOCS").is_some() {
        std::fs::write(path, &expected).unwrap_or_else(|e| panic!("{path}: {e}"));
        return;
    }
    assert!(
        page == expected,
        "{path} differs from the code's tables: UPDATE_DOCS=1 cargo test --release {tests}"
    );
}
