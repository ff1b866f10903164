//! Text of an XML document.

use quick_xml::Writer;
use quick_xml::events::{BytesDecl, Event};
use std::io;

/// An indented XML document.
pub fn document(write: impl FnOnce(&mut Writer<Vec<u8>>) -> io::Result<()>) -> io::Result<String> {
    let mut writer = Writer::new_with_indent(Vec::new(), b' ', 2);
    writer.write_event(Event::Decl(BytesDecl::new("1.0", Some("utf-8"), None)))?;
    write(&mut writer)?;
    let mut text = writer.into_inner();
    text.push(b'\n');
    String::from_utf8(text).map_err(io::Error::other)
}

/// Numbers as the formats want them.
pub fn spaced(numbers: impl IntoIterator<Item = f64>) -> String {
    let text: Vec<String> = numbers.into_iter().map(|x| format!("{x:.9}")).collect();
    text.join(" ")
}
