//! Objects made here, linked by `rust-lld` in disguise, and read back.

use std::path::{Path, PathBuf};
use std::process::Command;

use flix_xtensa::disguise::disguise;
use flix_xtensa::fault::Fault;
use flix_xtensa::instruction::Kind;
use flix_xtensa::link::{Error, Filled, link};

use crate::instructions;
use crate::objects::{
    EXPANSION, GLOBAL, INSTRUCTION, LOCAL, Object, SECTION, Section, WORD, archive,
};

/// Where the script of these tests puts code and data.
const CODE: u32 = 0x400d_0000;
const DATA: u32 = 0x3ffb_0000;
const SCRIPT: &str = "ENTRY(start)
SECTIONS {
  . = 0x400d0000;
  .text : { *(.literal .text .literal.* .text.*) }
  . = 0x3ffb0000;
  .data : { *(.data .data.*) }
}";

/// Returns where rustup keeps its linker.
fn lld() -> PathBuf {
    let print = |what| {
        let output = Command::new("rustc").args(["--print", what]).output().unwrap();
        String::from_utf8(output.stdout).unwrap().trim().to_owned()
    };
    let bin = Path::new(&print("target-libdir")).parent().unwrap().join("bin");
    let lld = bin.join(format!("rust-lld{}", std::env::consts::EXE_SUFFIX));
    assert!(lld.is_file(), "{} is part of every compiler of rustup", lld.display());
    lld
}

/// A folder with files to link.
struct Bench(tempfile::TempDir);

impl Bench {
    fn new() -> Self {
        let bench = Self(tempfile::tempdir().unwrap());
        bench.put("script.x", SCRIPT);
        bench
    }

    fn path(&self, name: &str) -> String {
        self.0.path().join(name).to_str().unwrap().to_owned()
    }

    fn put(&self, name: &str, contents: impl AsRef<[u8]>) {
        std::fs::write(self.0.path().join(name), contents).unwrap();
    }

    /// Links these arguments, behind the script and the output.
    fn link(&self, arguments: &[&str]) -> Result<(Filled, Program), Error> {
        let output = self.path("program");
        let mut all = vec![format!("-T{}", self.path("script.x")), "-o".into(), output.clone()];
        all.extend(arguments.iter().map(|argument| (*argument).to_owned()));
        let filled = link(&lld(), &all)?;
        Ok((filled, Program(std::fs::read(output).unwrap())))
    }

    /// Links one object, keeping `start` and what it reaches.
    fn link_object(&self, object: &Object) -> Result<(Filled, Program), Error> {
        self.put("object.o", object.bytes());
        self.link(&["--gc-sections", &self.path("object.o")])
    }
}

/// What was linked.
#[derive(Debug)]
struct Program(Vec<u8>);

impl Program {
    fn half(&self, at: usize) -> u32 {
        u32::from(u16::from_le_bytes([self.0[at], self.0[at + 1]]))
    }

    fn word(&self, at: usize) -> u32 {
        self.half(at) | self.half(at + 2) << 16
    }

    /// Returns the bytes from an address on, by the program's segments.
    fn at(&self, address: u32) -> &[u8] {
        let (first, count) = (self.word(28) as usize, self.half(44) as usize);
        let segments = (0..count).map(|number| first + number * 32);
        let of = |segment: &usize| {
            let (start, size) = (self.word(segment + 8), self.word(segment + 16));
            self.word(*segment) == 1 && (start..start + size).contains(&address)
        };
        let segment = segments.into_iter().find(of).unwrap();
        &self.0[(self.word(segment + 4) + address - self.word(segment + 8)) as usize..]
    }

    fn word_at(&self, address: u32) -> u32 {
        let bytes = self.at(address);
        u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])
    }
}

/// An object whose code `start` is the given section's.
fn program(
    code: Section,
    others: Vec<Section>,
    symbols: &[(&'static str, &'static str, u32)],
) -> Object {
    let start = ("start", code.name, 0);
    let sections = std::iter::once(code).chain(others).collect();
    Object::new(sections, &[symbols, &[start]].concat())
}

#[test]
fn each_instruction_names_its_target_in_another_section() {
    for case in instructions::all() {
        // The target is 20 bytes into its section, of which the addend is 8.
        let instruction = Section::code(".text.a").with(case.bytes, INSTRUCTION, "target", 8);
        let target = Section::code(".text.b").plain(&[0; 24]);
        let is_before = case.kind == Kind::LiteralLoad;
        let sections =
            if is_before { vec![target, instruction] } else { vec![instruction, target] };
        let object = Object::new(sections, &[("start", ".text.a", 0), ("target", ".text.b", 12)]);
        let (filled, program) = Bench::new().link_object(&object).unwrap();
        let (place, target) =
            if is_before { (CODE + 24, CODE + 20) } else { (CODE, CODE + 4 + 20) };
        assert_eq!((case.target)(program.at(place), place), target, "{}", case.name);
        assert_eq!(filled, [(case.kind, 1)].into(), "{}", case.name);
    }
}

#[test]
fn many_instructions_of_one_section_name_each_its_own_target() {
    let mut code = Section::code(".text.a").plain(&[0; 8]);
    let forwards: Vec<_> =
        instructions::all().filter(|case| case.kind != Kind::LiteralLoad).collect();
    let mut places = Vec::new();
    for (case, number) in forwards.iter().zip(0..) {
        places.push(code.bytes.len() as u32);
        // Each names the place of the next multiple of four from 32 bytes behind itself on.
        let target = (code.bytes.len() as i32 + 32) / 4 * 4;
        code = code.with(case.bytes, INSTRUCTION, "base", target).plain(&[number; 3]);
    }
    let code = code.plain(&[0; 64]);
    let object = Object::new(vec![code], &[("start", ".text.a", 0), ("base", ".text.a", 0)]);
    let (_, program) = Bench::new().link_object(&object).unwrap();
    for ((case, place), number) in forwards.iter().zip(places).zip(0_u8..) {
        let target = CODE + (place + 32) / 4 * 4;
        let bytes = program.at(CODE + place);
        assert_eq!((case.target)(bytes, CODE + place), target, "{}", case.name);
        assert_eq!(bytes[case.bytes.len()..][..3], [number; 3], "behind {}", case.name);
    }
}

#[test]
fn a_word_is_its_symbol_its_addend_and_what_stands_in_it() {
    for (contents, addend) in [(0, 0), (0, 12), (0, -4), (8, 0), (0xffff_fffc, 8)] {
        let code = Section::code(".text.a").with(&0_u32.to_le_bytes(), WORD, "data", 0);
        let data =
            Section::data(".data.x").with(&u32::to_le_bytes(contents), WORD, "start", addend);
        let object = program(code, vec![data], &[("data", ".data.x", 0)]);
        let (_, program) = Bench::new().link_object(&object).unwrap();
        assert_eq!(program.word_at(CODE), DATA);
        let expected = CODE.wrapping_add_signed(addend).wrapping_add(contents);
        assert_eq!(program.word_at(DATA), expected, "{contents:#x} and {addend}");
    }
}

#[test]
fn differences_and_long_calls_stay_as_they_are() {
    // Differences of 8, 16 and 32 bits of three kinds (GNU binutils, `include/elf/xtensa.h`), a long call, and nothing.
    let mut code = Section::code(".text.a");
    for kind in (17..=19).chain(57..=62).chain([EXPANSION, 0]) {
        code = code.with(&[kind, 2, 3, 4], kind, "start", 4);
    }
    let expected = code.bytes.clone();
    let (filled, program) = Bench::new().link_object(&program(code, vec![], &[])).unwrap();
    assert_eq!(program.at(CODE)[..expected.len()], expected);
    assert_eq!(filled, Filled::new());
}

#[test]
fn what_an_instruction_reaches_is_kept_and_the_rest_is_not() {
    let call = Section::code(".text.a").with(&[0x25, 0, 0], INSTRUCTION, "called", 0).plain(&[0]);
    let called = Section::code(".text.b").plain(b"kept");
    let other = Section::code(".text.c").plain(b"dropped!");
    let object =
        program(call, vec![called, other], &[("called", ".text.b", 0), ("other", ".text.c", 0)]);
    let (_, program) = Bench::new().link_object(&object).unwrap();
    let has = |text: &[u8]| program.0.windows(text.len()).any(|window| window == text);
    assert!(has(b"kept") && !has(b"dropped!"));
}

#[test]
fn the_program_is_one_for_xtensa_again_with_its_relocations() {
    let code = Section::code(".text.a").with(&[0x06, 0, 0], INSTRUCTION, "start", 0);
    let (_, program) = Bench::new().link_object(&program(code, vec![], &[])).unwrap();
    assert_eq!([program.half(18), program.word(36)], [94, 0x300]);
    let first = program.word(32) as usize;
    let sections =
        (0..program.half(48) as usize).map(|number| first + number * program.half(46) as usize);
    let of_relocations = sections.into_iter().find(|header| program.word(header + 4) == 4).unwrap();
    let relocation = program.word(of_relocations + 16) as usize;
    assert_eq!(program.word(relocation), CODE);
    assert_eq!(program.word(relocation + 4) & 0xff, u32::from(INSTRUCTION));
}

#[test]
fn archives_and_libraries_give_what_is_asked_for() {
    let call = Section::code(".text.a").with(&[0x25, 0, 0], INSTRUCTION, "called", 0).plain(&[0]);
    let called = Object::new(
        vec![Section::code(".text.b").with(&[0x06, 0, 0], INSTRUCTION, "far", 0).plain(&[0])],
        &[("called", ".text.b", 0)],
    );
    let far =
        Object::new(vec![Section::code(".text.far").plain(&[0; 4])], &[("far", ".text.far", 0)]);
    // One of an odd size in front, which is no object.
    let one = archive(&[("notes", b"odd".to_vec()), ("called.o", called.bytes())]);
    let bench = Bench::new();
    bench.put("start.o", program(call, vec![], &[]).bytes());
    bench.put("one.rlib", one);
    bench.put("libfar.a", archive(&[("far.o", far.bytes())]));
    let folder = bench.path("");
    for folders in [vec![format!("-L{folder}")], vec!["-L".to_owned(), folder]] {
        let (start, one) = (bench.path("start.o"), bench.path("one.rlib"));
        let folders = folders.iter().map(String::as_str);
        let arguments: Vec<&str> =
            folders.chain([&*start, &*one, "-lfar", "-nostartfiles"]).collect();
        let (filled, program) = bench.link(&arguments).unwrap();
        assert_eq!(filled, [(Kind::Call, 1), (Kind::Jump, 1)].into());
        let called = (instructions::OTHERS[3].target)(program.at(CODE), CODE);
        let far = (instructions::OTHERS[5].target)(program.at(called), called);
        assert_eq!([called, far], [CODE + 4, CODE + 8]);
    }
}

#[test]
fn arguments_may_stand_in_a_file() {
    let bench = Bench::new();
    let code = Section::code(".text.a").with(&[0x06, 0, 0], INSTRUCTION, "start", 0);
    bench.put("object.o", program(code, vec![], &[]).bytes());
    let [script, output, object] = ["script.x", "program", "object.o"].map(|name| bench.path(name));
    bench.put("arguments", format!("\"-T{script}\"\n-o\n\"{output}\"\n{object}\n"));
    let filled = link(&lld(), &[format!("@{}", bench.path("arguments"))]).unwrap();
    assert_eq!(filled, [(Kind::Jump, 1)].into());
    // As rustc writes a space: behind a backslash.
    bench.put("an object.o", std::fs::read(&object).unwrap());
    let spaced = bench.path("an object.o").replace('\\', r"\\").replace(' ', r"\ ");
    bench.put("arguments", format!("-T{script}\n-o\n{output}\n{spaced}\n"));
    let filled = link(&lld(), &[format!("@{}", bench.path("arguments"))]).unwrap();
    assert_eq!(filled, [(Kind::Jump, 1)].into());
}

#[test]
fn symbols_that_only_the_compiler_proper_would_define_are_found() {
    const HANDLER: &str = "_RNvCs1_7___rustc26___rust_alloc_error_handler";
    const REAL: &str = "_RNvCs1_7___rustc25___rdl_alloc_error_handler";
    const MARK: &str = "_RNvCs1_7___rustc35___rust_no_alloc_shim_is_unstable_v2";
    let code =
        Section::code(".text.a").with(&[0; 4], WORD, HANDLER, 0).with(&[0; 4], WORD, MARK, 0);
    let real = Section::code(".text.b").plain(&[0; 8]);
    let symbols = [(REAL, ".text.b", 0), ("no_init_hook", ".text.b", 4)];
    let (_, program) = Bench::new().link_object(&program(code, vec![real], &symbols)).unwrap();
    assert_eq!([CODE, CODE + 4].map(|at| program.word_at(at)), [CODE + 8, CODE + 12]);
}

#[test]
fn an_instruction_that_cannot_name_its_target_is_refused_and_leaves_no_program() {
    let bench = Bench::new();
    // A branch over 128 bytes, and a literal behind its load.
    let branch = Section::code(".text.a").with(&[0x26, 0x43, 0], INSTRUCTION, "start", 132);
    let load = branch.with(&[0x21, 0, 0], INSTRUCTION, "start", 200);
    let refused = bench.link_object(&program(load, vec![], &[])).unwrap_err();
    let message = refused.to_string();
    assert!(matches!(refused, Error::Misfits(misfits) if misfits.len() == 2), "{message}");
    assert!(message.contains("Branch over 128 bytes"), "{message}");
    assert!(!Path::new(&bench.path("program")).exists());
}

#[test]
fn arithmetic_of_128_bits_is_refused_where_it_is_linked_and_only_there() {
    let division = |name: &'static str| {
        let code = Section::code(".text.a").with(&[0x25, 0, 0], INSTRUCTION, name, 0).plain(&[0]);
        let others = [".text.wide", ".text.long"].map(|name| Section::code(name).plain(&[0; 4]));
        let symbols = [("__udivti3", ".text.wide", 0), ("__udivdi3", ".text.long", 0)];
        program(code, others.into(), &symbols)
    };
    let bench = Bench::new();
    let refused = bench.link_object(&division("__udivti3")).unwrap_err().to_string();
    assert!(refused.contains("__udivti3"), "{refused}");
    bench.link_object(&division("__udivdi3")).unwrap();
}

#[test]
fn every_function_for_128_bits_is_refused_whatever_it_does_with_them() {
    // Names of the compiler's library (compiler-rt, `lib/builtins/README.txt`), without those of 64 bits beside them.
    let wide = ["__multi3", "__muloti4", "__udivmodti4", "__clzti2", "__fixunsdfti", "__fixsfti"];
    let wide = wide.iter().chain(&["__floattidf", "__floatuntisf", "__rust_u128_mulo"]);
    let narrow = ["__muldi3", "__udivmoddi4", "__fixunsdfdi", "__floatundisf", "__rust_begin"];
    let bench = Bench::new();
    let outcome = |name: &'static str| {
        let code = Section::code(".text.a").with(&[0x25, 0, 0], INSTRUCTION, name, 0).plain(&[0]);
        let called = Section::code(".text.b").plain(&[0; 4]);
        bench.link_object(&program(code, vec![called], &[(name, ".text.b", 0)]))
    };
    for name in wide {
        assert!(
            matches!(outcome(name), Err(Error::Wide(names)) if names.contains(*name)),
            "{name}"
        );
    }
    narrow.iter().for_each(|name| assert!(outcome(name).is_ok(), "{name}"));
}

#[test]
fn what_is_called_and_defined_nowhere_is_named() {
    let code = Section::code(".text.a").with(&[0x25, 0, 0], INSTRUCTION, "nowhere", 0).plain(&[0]);
    let bench = Bench::new();
    let refused = bench.link_object(&program(code, vec![], &[])).unwrap_err().to_string();
    assert!(refused.contains("undefined: nowhere"), "{refused}");
    assert!(!Path::new(&bench.path("program")).exists());
}

#[test]
fn an_instruction_whose_target_is_lost_is_refused() {
    // Without a symbol; and of a symbol in a section that the script throws away.
    let without = Section::code(".text.a").with(&[0x06, 0, 0], INSTRUCTION, "", CODE as i32);
    let refused = disguise(&mut program(without, vec![], &[]).bytes());
    assert_eq!(refused, Err(Fault::Untargeted));
    let bench = Bench::new();
    bench.put("script.x", SCRIPT.replace(".data :", "/DISCARD/ : { *(.gone) } .data :"));
    for defined in [GLOBAL, LOCAL, SECTION] {
        let code = Section::code(".text.a").with(&[0x06, 0, 0], INSTRUCTION, "gone", 0);
        let gone = Section::code(".gone").plain(&[0; 4]);
        let object = Object { defined, ..program(code, vec![gone], &[("gone", ".gone", 0)]) };
        bench.put("object.o", object.bytes());
        let outcome = bench.link(&[&bench.path("object.o")]);
        assert!(outcome.is_err(), "{defined}: {outcome:?}");
    }
}

#[test]
fn nothing_is_written_behind_the_end_of_a_section() {
    for bytes in [&[0x25, 0, 0][..], &[0x8c, 0x03]] {
        for kept in 0..bytes.len() {
            // Cut: the rest of the instruction would be the next section's.
            let mut code = Section::code(".text.a").with(bytes, INSTRUCTION, "start", 0);
            code.bytes.truncate(kept);
            let refused = disguise(&mut program(code, vec![], &[]).bytes());
            assert_eq!(refused, Err(Fault::Truncated), "{kept} of {bytes:x?}");
        }
    }
    let mut data = Section::data(".data.x").with(&[0; 4], WORD, "start", 0);
    data.bytes.truncate(3);
    // And memory that is zeroed when the program starts.
    let zeroed = Section { is_zeroed: true, ..Section::data(".bss.x") };
    let zeroed = zeroed.with(&[0; 4], WORD, "start", 0);
    for section in [data, zeroed] {
        let code = Section::code(".text.a").plain(&[0; 4]);
        assert_eq!(disguise(&mut program(code, vec![section], &[]).bytes()), Err(Fault::Truncated));
    }
}

#[test]
fn one_member_twice_and_a_weak_symbol_give_what_a_linker_gives() {
    let called = |byte: u8| {
        let code = Section::code(".text.b").plain(&[byte; 4]);
        Object::new(vec![code], &[("called", ".text.b", 0)]).bytes()
    };
    let call = Section::code(".text.a").with(&[0x25, 0, 0], INSTRUCTION, "called", 0).plain(&[0]);
    let bench = Bench::new();
    bench.put("start.o", program(call, vec![], &[]).bytes());
    bench.put("twice.a", archive(&[("one.o", called(1)), ("one.o", called(2))]));
    let (_, program) = bench.link(&[&bench.path("start.o"), &bench.path("twice.a")]).unwrap();
    let target = (instructions::OTHERS[3].target)(program.at(CODE), CODE);
    assert_eq!(program.at(target)[..4], [1; 4]);
}

#[test]
fn an_unknown_relocation_and_one_without_an_addend_are_refused() {
    let code = |kind| Section::code(".text.a").with(&[0; 4], kind, "start", 0);
    for kind in [2, 10, 12, 16, 21, 56, 63] {
        let mut object = program(code(kind), vec![], &[]).bytes();
        assert_eq!(disguise(&mut object), Err(Fault::Relocation(kind)));
    }
    let object = Object { is_without_addends: true, ..program(code(WORD), vec![], &[]) };
    assert_eq!(disguise(&mut object.bytes()), Err(Fault::WithoutAddends));
}

#[test]
fn objects_for_other_processors_and_other_files_stay_as_they_are() {
    let mut object = program(Section::code(".text.a").plain(&[0; 4]), vec![], &[]).bytes();
    object[18] = 243;
    for file in [object, b"no object".to_vec(), b"!<arch>\n".to_vec(), Vec::new()] {
        let mut disguised = file.clone();
        disguise(&mut disguised).unwrap();
        assert_eq!(disguised, file);
    }
}

#[test]
fn what_only_a_shortening_linker_needs_is_left_out() {
    // A note as assemblers write it, in no memory, and one of Espressif's libraries.
    let notes = [".xt.prop", ".xtensa.info"];
    let code = Section::code(".text.a").plain(&[0; 4]);
    let sections =
        notes.map(|name| Section { is_note: true, ..Section::data(name) }.plain(b"note"));
    let (_, program) = Bench::new().link_object(&program(code, sections.into(), &[])).unwrap();
    for name in notes {
        assert!(!program.0.windows(name.len()).any(|window| window == name.as_bytes()), "{name}");
    }
}

#[test]
fn headers_of_another_size_are_refused() {
    // Of none: four billions of them would lie in one place.
    let mut object = program(Section::code(".text.a").plain(&[0; 4]), vec![], &[]).bytes();
    object[46..50].copy_from_slice(&[0; 4]);
    let first = object[32] as usize | (object[33] as usize) << 8;
    object[first + 20..first + 24].copy_from_slice(&[0xff; 4]);
    assert_eq!(disguise(&mut object), Err(Fault::Truncated));
}

#[test]
fn an_object_that_is_cut_short_never_panics() {
    let code = Section::code(".text.a").with(&[0; 4], WORD, "start", 0);
    let object = program(code, vec![], &[]).bytes();
    let archived = archive(&[("a.o", object.clone())]);
    for file in [object, archived] {
        for length in 0..file.len() {
            // Some are refused, some do without what is missing.
            let _ = disguise(&mut file[..length].to_vec());
        }
        for place in 0..file.len() {
            let mut damaged = file.clone();
            damaged[place] ^= 0xff;
            let _ = disguise(&mut damaged);
        }
    }
}
