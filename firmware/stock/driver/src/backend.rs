//! LLVM, by way of text.

use std::any::Any;
use std::io::Write;
use std::path::Path;
use std::process::{Command, Output, Stdio};

use rustc_codegen_ssa::traits::CodegenBackend;
use rustc_codegen_ssa::{CodegenResults, TargetConfig};
use rustc_data_structures::fx::FxIndexMap;
use rustc_metadata::EncodedMetadata;
use rustc_metadata::creader::MetadataLoaderDyn;
use rustc_middle::dep_graph::{WorkProduct, WorkProductId};
use rustc_middle::ty::TyCtxt;
use rustc_middle::util::Providers;
use rustc_session::Session;
use rustc_session::config::{
    CrateType, OutFileName, OutputFilenames, OutputType, OutputTypes, PrintRequest,
};
use rustc_span::Symbol;
use rustc_target::spec::TargetTuple;

use crate::replace;

/// Names the variable with the path of the text that this program, called anew, is to assemble.
pub(crate) const TEXT: &str = "XTENSA_TEXT";

/// A crate of a text in assembly language and nothing else, so that rustc's own LLVM assembles it.
const ASSEMBLER: &str = r#"
#![feature(no_core, lang_items, rustc_attrs, asm_experimental_arch)]
#![no_core]
#![crate_type = "lib"]
#[lang = "pointee_sized"]
pub trait PointeeSized {}
#[lang = "meta_sized"]
pub trait MetaSized: PointeeSized {}
#[lang = "sized"]
pub trait Sized: MetaSized {}
#[rustc_builtin_macro]
macro_rules! global_asm { () => {} }
#[rustc_builtin_macro]
macro_rules! include_str { () => {} }
#[rustc_builtin_macro]
macro_rules! env { () => {} }
global_asm!(include_str!(env!("XTENSA_TEXT")), options(raw));
"#;

/// LLVM, whose object files are assembled from its texts.
pub(crate) struct ByText(pub(crate) Box<dyn CodegenBackend>);

/// Assembles a text, whose literals are moved first.
fn assemble(session: &Session, text: &Path, object: &Path) {
    let error = match assembled(session, text, object) {
        Ok(output) if output.status.success() => return,
        Ok(output) => String::from_utf8_lossy(&output.stderr).into_owned(),
        Err(error) => error.to_string(),
    };
    session.dcx().fatal(format!("{} cannot be assembled: {error}", text.display()));
}

fn assembled(session: &Session, text: &Path, object: &Path) -> std::io::Result<Output> {
    std::fs::write(text, flix_xtensa::literals::moved(&std::fs::read_to_string(text)?))?;
    let target = match &session.opts.target_triple {
        TargetTuple::TargetJson { path_for_rustdoc, .. } => path_for_rustdoc.as_os_str(),
        TargetTuple::TargetTuple(name) => name.as_ref(),
    };
    let mut child = Command::new(std::env::current_exe()?)
        .args(["-", "--emit=obj", "-Zunstable-options", "-Cpanic=abort", "--cap-lints=allow"])
        .arg(format!("-Ctarget-feature={}", session.opts.cg.target_feature))
        .arg("--target")
        .arg(target)
        .arg("-o")
        .arg(object)
        .env(TEXT, std::path::absolute(text)?)
        .env("RUSTC_BOOTSTRAP", "1")
        .stdin(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()?;
    if let Some(mut source) = child.stdin.take() {
        source.write_all(ASSEMBLER.as_bytes())?;
    }
    child.wait_with_output()
}

impl CodegenBackend for ByText {
    fn name(&self) -> &'static str {
        self.0.name()
    }

    fn init(&self, session: &Session) {
        self.0.init(session);
    }

    fn print(&self, request: &PrintRequest, out: &mut String, session: &Session) {
        self.0.print(request, out, session);
    }

    fn target_config(&self, session: &Session) -> TargetConfig {
        self.0.target_config(session)
    }

    fn supported_crate_types(&self, session: &Session) -> Vec<CrateType> {
        self.0.supported_crate_types(session)
    }

    fn print_passes(&self) {
        self.0.print_passes();
    }

    fn print_version(&self) {
        self.0.print_version();
    }

    fn replaced_intrinsics(&self) -> Vec<Symbol> {
        self.0.replaced_intrinsics()
    }

    fn thin_lto_supported(&self) -> bool {
        false
    }

    fn has_zstd(&self) -> bool {
        self.0.has_zstd()
    }

    fn metadata_loader(&self) -> Box<MetadataLoaderDyn> {
        self.0.metadata_loader()
    }

    fn provide(&self, providers: &mut Providers) {
        self.0.provide(providers);
    }

    fn codegen_crate<'tcx>(&self, tcx: TyCtxt<'tcx>) -> Box<dyn Any> {
        let is_linked = [OutputType::Exe, OutputType::Object];
        if !is_linked.iter().any(|kind| tcx.sess.opts.output_types.contains_key(kind)) {
            return self.0.codegen_crate(tcx);
        }
        // What follows from the types that were asked for, and is kept once it is known.
        let _ = tcx.dependency_formats(());
        let types = &raw const tcx.sess.opts.output_types;
        let text = OutputTypes::new(&[(OutputType::Assembly, None::<OutFileName>)]);
        // SAFETY: no reference into the types is alive; the threads that write code are started by what is called next and
        // get copies of what they need.
        #[expect(unsafe_code, reason = "the compiler has no other way to change this setting")]
        let asked_for = unsafe { replace(types, text) };
        let ongoing = self.0.codegen_crate(tcx);
        // SAFETY: as above.
        #[expect(unsafe_code, reason = "the compiler has no other way to change this setting")]
        let _text = unsafe { replace(types, asked_for) };
        ongoing
    }

    fn join_codegen(
        &self,
        ongoing: Box<dyn Any>,
        session: &Session,
        outputs: &OutputFilenames,
    ) -> (CodegenResults, FxIndexMap<WorkProductId, WorkProduct>) {
        let (mut results, products) = self.0.join_codegen(ongoing, session, outputs);
        for module in results.modules.iter_mut().filter(|module| module.object.is_none()) {
            if let Some(text) = &module.assembly {
                let object = text.with_extension("o");
                assemble(session, text, &object);
                module.object = Some(object);
            }
        }
        (results, products)
    }

    fn link(
        &self,
        session: &Session,
        results: CodegenResults,
        metadata: EncodedMetadata,
        outputs: &OutputFilenames,
    ) {
        self.0.link(session, results, metadata, outputs);
    }
}
