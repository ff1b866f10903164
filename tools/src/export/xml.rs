//! Text of an XML document.

use quick_xml::Writer;
use quick_xml::events::{BytesDecl, BytesText, Event};
use std::io::{self, Write};

/// An indented XML document with a remark at its head.
pub fn document(
    remark: &str,
    write: impl FnOnce(&mut Writer<Vec<u8>>) -> io::Result<()>,
) -> io::Result<String> {
    let mut writer = Writer::new_with_indent(Vec::new(), b' ', 2);
    writer.write_event(Event::Decl(BytesDecl::new("1.0", Some("utf-8"), None)))?;
    writer.write_event(Event::Comment(BytesText::new(&format!(" {remark} "))))?;
    write(&mut writer)?;
    let mut text = writer.into_inner();
    text.push(b'\n');
    String::from_utf8(text).map_err(io::Error::other)
}

/// An element with attributes and nothing within.
pub fn empty<W: Write>(w: &mut Writer<W>, name: &str, of: &[(&str, &str)]) -> io::Result<()> {
    w.create_element(name).with_attributes(of.iter().copied()).write_empty().map(drop)
}

/// An element with attributes and others within.
pub fn element<W: Write>(
    writer: &mut Writer<W>,
    name: &str,
    attributes: &[(&str, &str)],
    within: impl FnOnce(&mut Writer<W>) -> io::Result<()>,
) -> io::Result<()> {
    let element = writer.create_element(name).with_attributes(attributes.iter().copied());
    element.write_inner_content(within).map(drop)
}

/// An element that holds words.
pub fn text<W: Write>(writer: &mut Writer<W>, name: &str, words: &str) -> io::Result<()> {
    writer.create_element(name).write_text_content(BytesText::new(words)).map(drop)
}

/// Numbers as the formats want them.
pub fn spaced(numbers: impl IntoIterator<Item = f64>) -> String {
    let text: Vec<String> = numbers.into_iter().map(|x| format!("{x:.9}")).collect();
    text.join(" ")
}
