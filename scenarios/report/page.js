"use strict";
(() => {
  const root = document.documentElement;
  const told = document.getElementById("told");
  const stored = () => { try { return localStorage.getItem("flightid-theme"); } catch { return null; } };
  const store = (value) => { try { localStorage.setItem("flightid-theme", value); } catch { /* a page from a file may not keep anything */ } };
  const dark = () => root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  const theme = document.getElementById("theme");
  const label = () => { theme.textContent = dark() ? "Light" : "Dark"; theme.setAttribute("aria-label", `${theme.textContent} colours`); };
  if (["light", "dark"].includes(stored())) root.dataset.theme = stored();
  theme.hidden = false;
  label();
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", label);
  theme.addEventListener("click", () => { root.dataset.theme = dark() ? "light" : "dark"; store(root.dataset.theme); label(); });

  // Numbers by their value, whatever is written; words by their letters; what has no number stays behind.
  const key = (cell) => cell.dataset.value === undefined ? null : Number(cell.dataset.value);
  const compare = (a, b, sign) => {
    const [x, y] = [key(a), key(b)];
    if (x !== null && y !== null) return sign * (x - y);
    if (x !== null || y !== null) return x !== null ? -1 : 1;
    return sign * a.textContent.localeCompare(b.textContent, "en", { numeric: true });
  };
  const NEXT = { none: "ascending", ascending: "descending", descending: "none" };
  for (const table of document.querySelectorAll("table")) {
    const body = table.tBodies[0];
    const first = [...body.rows];
    const heads = [...table.tHead.rows[0].cells];
    heads.forEach((head, at) => {
      head.setAttribute("aria-sort", "none");
      head.querySelector("button").addEventListener("click", () => {
        const order = NEXT[head.getAttribute("aria-sort")];
        heads.forEach((other) => other.setAttribute("aria-sort", other === head ? order : "none"));
        const sign = order === "descending" ? -1 : 1;
        const rows = order === "none" ? first : [...first].sort((a, b) => compare(a.cells[at], b.cells[at], sign));
        body.append(...rows);
        told.textContent = order === "none" ? "as it was" : `sorted by ${head.textContent.trim()}, ${order}`;
      });
    });
  }

  // For a spreadsheet: full numbers, a column of its own for each sigma.
  const matrix = (table) => {
    const rows = [...table.tBodies[0].rows];
    const heads = [...table.tHead.rows[0].cells];
    const withSigma = heads.map((_, at) => rows.some((row) => row.cells[at].dataset.sigma !== undefined));
    const head = heads.flatMap((cell, at) => { const text = cell.textContent.trim().replace(/\s+/g, " "); return withSigma[at] ? [text, `sigma of ${text}`] : [text]; });
    const body = rows.map((row) => [...row.cells].flatMap((cell, at) => {
      const value = cell.dataset.value ?? cell.textContent.trim().replace(/\s+/g, " ");
      return withSigma[at] ? [value, cell.dataset.sigma ?? ""] : [value];
    }));
    return [head, ...body];
  };
  const lines = (table) => matrix(table).map((row) => row.join("\t")).join("\n") + "\n";

  // For a report: numbers as they are shown.
  const shown = (table) => [table.tHead.rows[0], ...table.tBodies[0].rows].map((row) => [...row.cells].map((cell) => cell.textContent.trim().replace(/\s+/g, " ")));
  const markdown = (table) => {
    const [head, ...body] = shown(table).map((row) => row.map((text) => text.replaceAll("|", "\\|")));
    return [head, head.map(() => "---"), ...body].map((row) => `| ${row.join(" | ")} |`).join("\n") + "\n";
  };
  const SIGNS = { "±": "$\\pm$", "−": "$-$", "σ": "$\\sigma$", "²": "$^2$", "³": "$^3$", "→": "$\\to$", "–": "--", "\\": "\\textbackslash{}", "~": "\\textasciitilde{}", "^": "\\textasciicircum{}" };
  const tex = (text) => text.replace(/[&%$#_{}]/g, "\u0000$&").replace(/[±−σ²³→–\\~^]/g, (sign) => SIGNS[sign]).replaceAll("\u0000", "\\");
  const latex = (table) => {
    const [head, ...body] = shown(table).map((row) => `${row.map(tex).join(" & ")} \\\\`);
    const kinds = [...table.tHead.rows[0].cells].map((cell) => cell.classList.contains("n") ? "r" : "l").join("");
    return [`\\begin{tabular}{${kinds}}`, "\\hline", head, "\\hline", ...body, "\\hline", "\\end{tabular}"].join("\n") + "\n";
  };

  // A workbook is an archive of texts; they are stored as they are, each with its checksum.
  const CRC = Uint32Array.from({ length: 256 }, (_, n) => { let c = n; for (let k = 0; k < 8; k += 1) c = c & 1 ? 0xedb88320 ^ (c >>> 1) : c >>> 1; return c; });
  const archive = (files) => {
    const encoder = new TextEncoder(), parts = [], entries = [];
    let offset = 0;
    const numbers = (...pairs) => { const out = new DataView(new ArrayBuffer(pairs.reduce((sum, [size]) => sum + size, 0))); let at = 0; for (const [size, value] of pairs) { size === 2 ? out.setUint16(at, value, true) : out.setUint32(at, value, true); at += size; } return new Uint8Array(out.buffer); };
    for (const [path, text] of Object.entries(files)) {
      const name = encoder.encode(path), data = encoder.encode(text);
      let crc = 0xffffffff;
      for (const byte of data) crc = CRC[(crc ^ byte) & 255] ^ (crc >>> 8);
      const common = [[2, 20], [2, 0x800], [2, 0], [2, 0], [2, 0x21], [4, (crc ^ 0xffffffff) >>> 0], [4, data.length], [4, data.length], [2, name.length], [2, 0]];
      parts.push(numbers([4, 0x04034b50], ...common), name, data);
      entries.push(numbers([4, 0x02014b50], [2, 20], ...common, [2, 0], [2, 0], [2, 0], [4, 0], [4, offset]), name);
      offset += 30 + name.length + data.length;
    }
    const size = entries.reduce((sum, each) => sum + each.length, 0), count = entries.length / 2;
    return new Blob([...parts, ...entries, numbers([4, 0x06054b50], [2, 0], [2, 0], [2, count], [2, count], [4, size], [4, offset], [2, 0])], { type: "application/vnd.openxmlformats-officedocument.spreadsheetml.sheet" });
  };
  const xml = (text) => text.replace(/[\u0000-\u0008\u000b\u000c\u000e-\u001f]/g, "").replace(/[&<>"]/g, (sign) => `&#${sign.charCodeAt(0)};`);
  // The names of the format are addresses that nobody fetches.
  const workbook = (table) => {
    const cell = (text) => /^-?\d+(\.\d+)?(e[-+]?\d+)?$/i.test(text) ? `<c><v>${text}</v></c>` : `<c t="inlineStr"><is><t xml:space="preserve">${xml(text)}</t></is></c>`;
    const open = '<?xml version="1.0" encoding="UTF-8" standalone="yes"?>', office = ["http:", "", "schemas.openxmlformats.org", ""].join("/"), main = `${office}spreadsheetml/2006/main`, relation = `${office}officeDocument/2006/relationships`, packaged = `${office}package/2006`, kind = "application/vnd.openxmlformats-officedocument.spreadsheetml";
    return archive({
      "[Content_Types].xml": `${open}<Types xmlns="${packaged}/content-types"><Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/><Override PartName="/xl/workbook.xml" ContentType="${kind}.sheet.main+xml"/><Override PartName="/xl/worksheets/sheet1.xml" ContentType="${kind}.worksheet+xml"/></Types>`,
      "_rels/.rels": `${open}<Relationships xmlns="${packaged}/relationships"><Relationship Id="r1" Type="${relation}/officeDocument" Target="xl/workbook.xml"/></Relationships>`,
      "xl/workbook.xml": `${open}<workbook xmlns="${main}" xmlns:r="${relation}"><sheets><sheet name="Table" sheetId="1" r:id="r1"/></sheets></workbook>`,
      "xl/_rels/workbook.xml.rels": `${open}<Relationships xmlns="${packaged}/relationships"><Relationship Id="r1" Type="${relation}/worksheet" Target="worksheets/sheet1.xml"/></Relationships>`,
      "xl/worksheets/sheet1.xml": `${open}<worksheet xmlns="${main}"><sheetData>${matrix(table).map((row) => `<row>${row.map(cell).join("")}</row>`).join("")}</sheetData></worksheet>`,
    });
  };
  const save = (blob, name) => {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(blob);
    link.download = name;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
    return true;
  };
  const copy = async (text) => {
    try { await navigator.clipboard.writeText(text); return true; } catch { /* not allowed here: the older way */ }
    const area = document.createElement("textarea");
    area.value = text;
    area.className = "unseen";
    document.body.append(area);
    area.select();
    const done = document.execCommand("copy");
    area.remove();
    return done;
  };
  for (const button of document.querySelectorAll("button.copy")) {
    button.addEventListener("click", async () => {
      const done = await copy(lines(button.parentElement.querySelector("table")));
      button.textContent = done ? "Copied" : "Not copied";
      told.textContent = button.textContent;
      setTimeout(() => { button.textContent = "Copy"; }, 1500);
    });
  }

  for (const choice of document.querySelectorAll("select.formats")) {
    choice.hidden = false;
    choice.addEventListener("change", async () => {
      const table = choice.parentElement.querySelector("table");
      const name = (table.caption.textContent.trim() || table.parentElement.ariaLabel).replace(/[^\p{L}\p{N}]+/gu, "_").slice(0, 60) || "table";
      const done = choice.value === "xlsx" ? save(workbook(table), `${name}.xlsx`) : await copy((choice.value === "latex" ? latex : markdown)(table));
      told.textContent = !done ? "Not copied" : choice.value === "xlsx" ? "Saved" : "Copied";
      choice.value = "";
    });
  }

  let opened = [];
  addEventListener("beforeprint", () => { opened = [...document.querySelectorAll("details:not([open])")]; opened.forEach((each) => { each.open = true; }); });
  addEventListener("afterprint", () => { opened.forEach((each) => { each.open = false; }); });
})();
