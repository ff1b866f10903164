//! The program starts and explains itself. That this test asks for it has `cargo test --workspace`
//! build the program as it builds the tests: those of `linkage-tests` run what is built here.

use std::process::Command;

#[test]
fn help_names_every_command_and_version_says_which_program_it_is() {
    let said = |argument: &str| {
        let output = Command::new(env!("CARGO_BIN_EXE_linkage")).arg(argument).output().unwrap();
        assert!(output.status.success(), "{argument}");
        String::from_utf8(output.stdout).unwrap()
    };
    let help = said("--help");
    for command in ["learn", "recognise", "predict", "serve", "record", "export", "doctor"] {
        assert!(help.contains(command), "{command}: {help}");
    }
    assert_eq!(said("--version").trim(), concat!("linkage ", env!("CARGO_PKG_VERSION")));
}
