//! Literals in assembly text as LLVM and people write it.

use flix_xtensa::literals::moved;

/// Returns each word `.4byte` with the section that it ends up in, and each label of code with its own.
fn places(text: &str) -> Vec<(String, String)> {
    let mut section = ".text".to_owned();
    let mut left = Vec::new();
    let mut places = Vec::new();
    let mut label = "";
    for line in moved(text).lines().map(str::trim).map(str::to_owned).collect::<Vec<_>>().leak() {
        let named = |line: &str| line.split([' ', ',']).nth(1).unwrap().to_owned();
        match line.split(' ').next().unwrap() {
            ".section" => section = named(line),
            ".text" => section = ".text".to_owned(),
            ".pushsection" => left.push(std::mem::replace(&mut section, named(line))),
            ".popsection" => section = left.pop().unwrap(),
            ".4byte" => places.push((format!("{label} {}", &line[7..]), section.clone())),
            word if word.ends_with(':') => {
                label = word.trim_end_matches(':');
                if !label.starts_with(".LCPI") && !label.starts_with("sym") {
                    places.push((label.to_owned(), section.clone()));
                }
            }
            _ => {}
        }
    }
    places
}

fn pairs(places: &[(&str, &str)]) -> Vec<(String, String)> {
    places.iter().map(|(what, section)| ((*what).to_owned(), (*section).to_owned())).collect()
}

/// Two functions, as LLVM writes them: the literals of the second stand in the section of the first.
const TWO: &str = "\t.section .text.first,\"ax\",@progbits
\t.literal_position
\t.literal .LCPI0_0, far
\t.p2align 2
first:
\tl32r a8, .LCPI0_0
\t.literal .LCPI1_0, -559038737
\t.literal .LCPI1_1, other+4
\t.section .text.second,\"ax\",@progbits
\t.p2align 2
second:
\tl32r a8, .LCPI1_0
";

#[test]
fn literals_go_before_the_function_that_loads_them() {
    let expected = [
        (".LCPI0_0 far", ".literal.first"),
        ("first", ".text.first"),
        (".LCPI1_0 -559038737", ".literal.second"),
        (".LCPI1_1 other+4", ".literal.second"),
        ("second", ".text.second"),
    ];
    assert_eq!(places(TWO), pairs(&expected));
}

#[test]
fn the_section_of_literals_appears_before_that_of_the_code() {
    let text = moved(TWO);
    for function in ["first", "second"] {
        let [literals, code] =
            [".literal", ".text"].map(|kind| text.find(&format!("{kind}.{function},")));
        assert!(literals < code, "{text}");
    }
    assert!(!text.contains(".literal_position"));
}

#[test]
fn each_literal_is_aligned() {
    let text = moved(TWO);
    for (at, _) in text.match_indices(".LCPI1_0:").chain(text.match_indices(".LCPI0_0:")) {
        let before = text[..at].lines().last().unwrap();
        assert_eq!(before, ".p2align 2", "{text}");
    }
}

#[test]
fn literals_of_handwritten_code_stay_with_their_section() {
    let text = "\t.section .rwtext,\"ax\",@progbits
\t.literal sym_main, main  // where it begins
Reset:
\tl32r a2, sym_main
";
    assert_eq!(places(text), pairs(&[("sym_main main", ".rwtext.literal"), ("Reset", ".rwtext")]));
}

#[test]
fn a_section_that_is_left_is_come_back_to() {
    let text = "\t.section .text.outer,\"ax\",@progbits
outer:
\t.pushsection .rwtext.inner,\"ax\",@progbits
inner:
\t.pushsection .rodata.deep,\"a\",@progbits
deep:
\t.popsection
\t.literal sym_inner, one
\t.popsection
\t.literal sym_outer, two
";
    let expected = [
        ("outer", ".text.outer"),
        ("inner", ".rwtext.inner"),
        ("deep", ".rodata.deep"),
        ("sym_inner one", ".rwtext.inner.literal"),
        ("sym_outer two", ".literal.outer"),
    ];
    assert_eq!(places(text), pairs(&expected));
}

#[test]
fn literals_wait_for_code_over_a_table_of_data() {
    let text = "\t.literal .LCPI0_0, table
\t.section .rodata.table,\"a\",@progbits
table:
\t.byte 1
\t.section .text.user,\"ax\",@progbits
user:
\tl32r a8, .LCPI0_0
";
    let expected =
        [("table", ".rodata.table"), (".LCPI0_0 table", ".literal.user"), ("user", ".text.user")];
    assert_eq!(places(text), pairs(&expected));
}

#[test]
fn literals_wait_for_code_over_variables() {
    for section in [".data", ".bss"] {
        let text = format!(
            "\t.literal .LCPI0_0, table\n\t{section}\ntable:\n\t.byte 0\n\t.text\nuser:\n\tl32r a8, .LCPI0_0\n"
        );
        let found = places(&text);
        assert!(found.contains(&(".LCPI0_0 table".to_owned(), ".literal".to_owned())), "{found:?}");
    }
}

#[test]
fn a_remark_is_no_function_and_a_section_named_as_code_is_code() {
    let text = "\t.section .text.first,\"ax\",@progbits
first:
\t.literal .LCPI1_0, far
\t// what follows:
\t.section .text.second
second:
\tl32r a8, .LCPI1_0
";
    let expected =
        [("first", ".text.first"), (".LCPI1_0 far", ".literal.second"), ("second", ".text.second")];
    assert_eq!(places(text), pairs(&expected));
}

#[test]
fn everything_else_stays_as_it_is() {
    let text = "\t.file \"x\"\n\t.text\nname:\n\tentry a1, 32\n\tretw.n\n\t.section .data,\"aw\",@progbits\nword:\n\t.word 7\n";
    let kept: Vec<&str> = moved(text).leak().lines().filter(|line| text.contains(line)).collect();
    assert_eq!(kept, text.lines().collect::<Vec<_>>());
}
