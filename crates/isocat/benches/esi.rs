//! How fast descriptions are imported, in bytes a second: one made here, and those that lie beside
//! the project, if there are any.

use std::fmt::Write as _;
use std::hint::black_box;
use std::path::{Path, PathBuf};

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use isocat::esi::EsiFile;

/// A description of 20 drives with PDOs, OpModes and a dictionary of records.
fn description() -> String {
    let mut text = String::from(
        "<?xml version=\"1.0\" encoding=\"utf-8\"?>\n<EtherCATInfo>\n\t<Vendor><Id>#x1</Id><Name>Nobody</Name></Vendor>\n\
         \t<Descriptions>\n\t\t<Groups><Group><Type>G</Type><Name>Group</Name></Group></Groups>\n\t\t<Devices>\n",
    );
    for device in 0..20 {
        write!(
            text,
            "\t\t\t<Device Physics=\"YY\">\n\t\t\t\t<Type ProductCode=\"#x{device:08x}\" \
             RevisionNo=\"#x00010000\">Box-{device}</Type>\n\t\t\t\t<Name LcId=\"1033\">Box {device}</Name>\n\
             \t\t\t\t<GroupType>G</GroupType>\n\t\t\t\t<Profile>\n\t\t\t\t\t<ProfileNo>5001</ProfileNo>\n\
             \t\t\t\t\t<Dictionary>\n\t\t\t\t\t\t<DataTypes>\n",
        )
        .unwrap();
        for index in 0x2000..0x2060 {
            write!(
                text,
                "\t\t\t\t\t\t\t<DataType>\n\t\t\t\t\t\t\t\t<Name>DT{index:04X}</Name>\n\t\t\t\t\t\t\t\t<BitSize>208</BitSize>\n"
            )
            .unwrap();
            for sub in 0..7 {
                let (kind, bits) = if sub == 0 { ("USINT", 8) } else { ("UDINT", 32) };
                let offset = if sub == 0 { 0 } else { 16 + 32 * (sub - 1) };
                write!(
                    text,
                    "\t\t\t\t\t\t\t\t<SubItem>\n\t\t\t\t\t\t\t\t\t<SubIdx>{sub}</SubIdx>\n\
                     \t\t\t\t\t\t\t\t\t<Name>Entry {sub}</Name>\n\t\t\t\t\t\t\t\t\t<Type>{kind}</Type>\n\
                     \t\t\t\t\t\t\t\t\t<BitSize>{bits}</BitSize>\n\t\t\t\t\t\t\t\t\t<BitOffs>{offset}</BitOffs>\n\
                     \t\t\t\t\t\t\t\t\t<Flags>\n\t\t\t\t\t\t\t\t\t\t<Access WriteRestrictions=\"PreOP\">rw</Access>\n\
                     \t\t\t\t\t\t\t\t\t\t<PdoMapping>T</PdoMapping>\n\t\t\t\t\t\t\t\t\t</Flags>\n\t\t\t\t\t\t\t\t</SubItem>\n",
                )
                .unwrap();
            }
            text += "\t\t\t\t\t\t\t</DataType>\n";
        }
        text += "\t\t\t\t\t\t</DataTypes>\n\t\t\t\t\t\t<Objects>\n";
        for index in 0x2000..0x2060 {
            write!(
                text,
                "\t\t\t\t\t\t\t<Object>\n\t\t\t\t\t\t\t\t<Index>#x{index:04X}</Index>\n\t\t\t\t\t\t\t\t<Name>Object</Name>\n\
                 \t\t\t\t\t\t\t\t<Type>DT{index:04X}</Type>\n\t\t\t\t\t\t\t\t<BitSize>208</BitSize>\n\t\t\t\t\t\t\t\t<Info>\n"
            )
            .unwrap();
            for sub in 0..7 {
                let data = if sub == 0 { "06" } else { "90d00300" };
                write!(
                    text,
                    "\t\t\t\t\t\t\t\t\t<SubItem>\n\t\t\t\t\t\t\t\t\t\t<Name>Entry {sub}</Name>\n\t\t\t\t\t\t\t\t\t\t<Info>\n\
                     \t\t\t\t\t\t\t\t\t\t\t<DefaultData>{data}</DefaultData>\n\t\t\t\t\t\t\t\t\t\t</Info>\n\
                     \t\t\t\t\t\t\t\t\t</SubItem>\n",
                )
                .unwrap();
            }
            text += "\t\t\t\t\t\t\t\t</Info>\n\t\t\t\t\t\t\t\t<Flags><Access>ro</Access></Flags>\n\t\t\t\t\t\t\t</Object>\n";
        }
        text += "\t\t\t\t\t\t</Objects>\n\t\t\t\t\t</Dictionary>\n\t\t\t\t</Profile>\n";
        text += "\t\t\t\t<Fmmu>Outputs</Fmmu>\n\t\t\t\t<Fmmu>Inputs</Fmmu>\n\
             \t\t\t\t<Sm ControlByte=\"#x26\" StartAddress=\"#x1000\" DefaultSize=\"128\">MBoxOut</Sm>\n\
             \t\t\t\t<Sm ControlByte=\"#x22\" StartAddress=\"#x1080\" DefaultSize=\"128\">MBoxIn</Sm>\n\
             \t\t\t\t<Sm ControlByte=\"#x64\" StartAddress=\"#x1100\" DefaultSize=\"8\">Outputs</Sm>\n\
             \t\t\t\t<Sm ControlByte=\"#x20\" StartAddress=\"#x1400\" DefaultSize=\"8\">Inputs</Sm>\n";
        for (name, first) in [("RxPdo", 0x1600), ("TxPdo", 0x1A00)] {
            for index in first..first + 16 {
                let sm = if index == first { " Sm=\"2\"" } else { "" };
                writeln!(
                    text,
                    "\t\t\t\t<{name} Fixed=\"1\"{sm}><Index>#x{index:04X}</Index><Name>PDO</Name><Entry>\
                     <Index>#x2000</Index><SubIndex>1</SubIndex><BitLen>32</BitLen><Name>Value</Name>\
                     <DataType>UDINT</DataType></Entry></{name}>"
                )
                .unwrap();
            }
        }
        text += "\t\t\t\t<Mailbox><CoE SdoInfo=\"true\"/></Mailbox>\n\t\t\t\t<Dc>\n\t\t\t\t\t<OpMode><Name>DC</Name>\
             <AssignActivate>#x300</AssignActivate><CycleTimeSync0 Factor=\"1\">0</CycleTimeSync0></OpMode>\n\
             \t\t\t\t</Dc>\n\t\t\t\t<Eeprom><ByteSize>2048</ByteSize><ConfigData>050c00cce803</ConfigData></Eeprom>\n\
             \t\t\t</Device>\n";
    }
    text + "\t\t</Devices>\n\t</Descriptions>\n</EtherCATInfo>\n"
}

fn import(c: &mut Criterion) {
    let mut group = c.benchmark_group("esi");
    let text = description();
    group.throughput(Throughput::Bytes(text.len() as u64));
    group.bench_function("generated", |b| {
        b.iter(|| EsiFile::from_bytes("generated.xml", black_box(text.as_bytes())).unwrap());
    });
    let shared = std::env::var_os("ISOCAT_SHARED").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared"),
        PathBuf::from,
    );
    let entries = std::fs::read_dir(shared.join("esi")).into_iter().flatten();
    let paths = entries.map(|entry| entry.unwrap().path());
    let xml = paths.filter(|path| path.extension().is_some_and(|end| end == "xml"));
    let files: Vec<Vec<u8>> = xml.map(|path| std::fs::read(path).unwrap()).collect();
    if files.is_empty() {
        println!("skipped: no descriptions beside the project");
    } else {
        group.throughput(Throughput::Bytes(files.iter().map(|bytes| bytes.len() as u64).sum()));
        group.sample_size(20);
        group.bench_function("published", |b| {
            b.iter(|| {
                files.iter().filter(|bytes| EsiFile::from_bytes("x.xml", bytes).is_ok()).count()
            });
        });
    }
    group.finish();
}

criterion_group!(benches, import);
criterion_main!(benches);
