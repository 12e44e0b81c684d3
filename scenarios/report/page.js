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
  const lines = (table) => {
    const rows = [...table.tBodies[0].rows];
    const heads = [...table.tHead.rows[0].cells];
    const withSigma = heads.map((_, at) => rows.some((row) => row.cells[at].dataset.sigma !== undefined));
    const head = heads.flatMap((cell, at) => { const text = cell.textContent.trim().replace(/\s+/g, " "); return withSigma[at] ? [text, `sigma of ${text}`] : [text]; });
    const body = rows.map((row) => [...row.cells].flatMap((cell, at) => {
      const value = cell.dataset.value ?? cell.textContent.trim().replace(/\s+/g, " ");
      return withSigma[at] ? [value, cell.dataset.sigma ?? ""] : [value];
    }));
    return [head, ...body].map((row) => row.join("\t")).join("\n") + "\n";
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

  let opened = [];
  addEventListener("beforeprint", () => { opened = [...document.querySelectorAll("details:not([open])")]; opened.forEach((each) => { each.open = true; }); });
  addEventListener("afterprint", () => { opened.forEach((each) => { each.open = false; }); });
})();
