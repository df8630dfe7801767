// The queue: a list beside the picture, or a gallery over it. Only the pieces that are seen are
// asked for, and only their cards exist, so that thousands of objects are no more work than ten.
(() => {
  const PIECE = 40, LATER_MS = 30, DRAWN_MS = 1200, TRIES = 60;
  const LIST = { width: 0, height: 54 }, GALLERY = { width: 184, height: 182 };
  const view = { search: "", state: "", sort: "order", wide: false };
  let sure = new Set(), unchecked = [];  // predicted with at least the confidence of the box
  const picked = new Set(), cards = new Map(), pieces = new Map(), asked = new Set();
  let words = null, answer = { total: 0, all: 0, states: {}, today: 0, at: -1 };
  let current = null, followed = null, serial = 0, counted = 0, root = null, parts = {};
  const timers = new Map();  // action -> its delay
  const page = Math.random().toString(36).slice(2);
  let looks = 0;  // while one lasts, results that come in don't change the order

  const make = (name, className = "", attributes = {}, ...children) => {
    const node = document.createElement(name);
    node.className = className;
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    node.append(...children);
    return node;
  };
  const send = (action, value) => window.__artiworldMarkup.send(action, value);
  const bulk = (action, value = "", ids = [...picked]) =>
    send("bulk", JSON.stringify({ action, value, ids }));

  // --- what is asked for

  const url = (more) => "/queue.json?" + new URLSearchParams({
    search: view.search, state: view.state, sort: view.sort, current: current ?? -1,
    look: `${page}.${looks}`, ...more });
  const ask = async (piece) => {
    if (asked.has(piece)) return;
    asked.add(piece);
    const mine = serial;
    try {
      const got = await (await fetch(url({ first: piece * PIECE, count: PIECE }))).json();
      if (mine !== serial) return;
      pieces.set(piece, got.rows);
      answer = got;
      draw();
    } catch { asked.delete(piece); }  // the server is away; it says when it is back
  };
  // What is shown stays until the new answer is there.
  const again = () => { serial += 1; asked.clear(); draw(); count(); };
  const count = async () => {
    if (!picked.size) return;
    const all = { search: "", state: "", ids: 1, above: parts.above.value || 0 };
    const mine = counted += 1;
    const found = await (await fetch(url(all))).json();
    if (mine !== counted) return;  // answers may overtake one another
    sure = new Set(found.ids);
    unchecked = found.unchecked;
    draw();
  };
  const anew = () => { looks++; pieces.clear(); parts.scroll.scrollTop = 0; again(); };
  const soon = (action) => {
    clearTimeout(timers.get(action));
    timers.set(action, setTimeout(action, LATER_MS));
  };

  // --- the frame around the cards

  const option = ([value, text]) => make("option", "", { value }, text);
  const control = (name, label, node, on) => {
    node.setAttribute("aria-label", label);
    if (node.tagName === "BUTTON" && !node.dataset.tip) node.title = label;
    node.addEventListener(node.tagName === "BUTTON" ? "click" : "input", on);
    return (parts[name] = node);
  };
  const press = (text, label, className, on, name = label) =>
    control(name, label, make("button", `aw-button ${className}`, { type: "button" }, text), on);
  const build = () => {
    const search = control("search", words.search, make("input", "aw-input",
      { type: "search", placeholder: words.search }), () => {
      view.search = parts.search.value;
      soon(anew);
    });
    const filter = control("filter", words.filter, make("select", "aw-input"), () => {
      view.state = filter.value;
      anew();
    });
    filter.append(...[["", words.all], ...words.states].map(option));
    const sort = control("sort", words.sort, make("select", "aw-input"), () => {
      view.sort = sort.value;
      anew();
    });
    sort.append(...words.sorts.map(option));
    parts.scroll = make("div", "aw-scroll", { tabindex: "-1" });
    parts.room = make("div", "aw-room");
    parts.empty = make("p", "aw-empty", {}, words.empty);
    parts.scroll.append(parts.room, parts.empty);
    parts.scroll.addEventListener("scroll", draw, { passive: true });
    new ResizeObserver(draw).observe(parts.scroll);
    parts.said = make("span", "aw-said", { role: "status" });
    parts.category = make("input", "aw-input", { list: "aw-categories", placeholder: words.category,
      "aria-label": words.category });
    const known = make("datalist", "", { id: "aw-categories" });
    known.append(...words.categories.map((c) => option([c, c])));
    parts.above = make("input", "aw-input aw-number", { type: "number", min: 0, max: 100, value: 90,
      "aria-label": words.above });
    parts.above.addEventListener("input", () => soon(count));
    parts.people = make("select", "aw-input aw-people", { "aria-label": words.assignTo });
    parts.bulk = make("div", "aw-bulk", {}, parts.said,
      press(words.pickAll, words.pickAll, "aw-small", pickAll, "pickAll"),
      press(words.clear, words.clear, "aw-small", () => { picked.clear(); draw(); }),
      parts.category, known,
      press(words.set, words.setCategory, "aw-small", () => bulk("category", parts.category.value)),
      press(words.predict, words.predict, "aw-small", () => bulk("predict")),
      press(words.check, words.check, "aw-small", () => bulk("check", "", mine()), "check"),
      press(words.accept, words.accept, "aw-small", () => bulk("accept", parts.above.value), "accept"),
      parts.above, make("span", "", {}, "%"),
      press(words.assign, words.assignHint, "aw-small aw-people", () => bulk("assign", parts.people.value)),
      parts.people);
    const exporting = press(words.exportThem, words.exportHint, "aw-small aw-export", async () => {
      const accepted = url({ ids: 1, ...(view.state ? {} : { state: "accepted" }) });
      const ids = picked.size ? [...picked] : (await (await fetch(accepted)).json()).ids;
      widen(false);  // viser's dialog would lie below
      bulk("export", "", ids);
    }, "export");
    root = make("section", "aw-queue", { "aria-label": words.title },
      make("div", "aw-tools", {}, search, filter, sort, exporting,
        press("", words.project, "aw-icon", () => {
          if (view.wide) widen(false);  // viser's dialog would lie below
          send("project", "");
        }, "project"),
        press("", words.gallery, "aw-icon aw-wide", () => widen(!view.wide), "widen")),
      parts.bulk, parts.scroll, press(words.sortAgain, words.sortAgain, "aw-small", anew, "again"));
    parts.widen.innerHTML = words.icon;
    parts.project.innerHTML = words.projectIcon;
  };
  const mine = () => unchecked.filter((id) => picked.has(id));
  const pickAll = async () => {
    for (const id of (await (await fetch(url({ ids: 1 }))).json()).ids) picked.add(id);
    draw();
    count();
  };
  const widen = (wide) => {
    view.wide = wide;
    followed = null;
    root.classList.toggle("wide", wide);
    settle();
    anew();
    if (wide) {
      send("people", "");
      parts.search.focus();
    }
  };
  // viser makes its panel anew when it is folded; the list goes where its place is.
  const settle = () => {
    if (!words) return;
    if (!root) build();
    const home = view.wide ? document.body : document.getElementById("artiworld-queue");
    if (home && root.parentElement !== home) { home.append(root); draw(); }
  };
  setInterval(settle, 200);

  // --- the cards

  const cardOf = (row) => {
    if (cards.has(row.id)) return cards.get(row.id);
    const image = make("img", "", { alt: "", width: 104, height: 78 });
    const box = make("input", "aw-pick", { type: "checkbox" });
    const name = make("b"), about = make("small"), sure = make("small", "aw-sure");
    const open = make("button", "aw-open", { type: "button" }, image,
      make("span", "", {}, name, about, sure));
    const node = make("div", "aw-card", {}, open, box);
    const card = { node, open, image, box, name, about, sure, src: "", tries: 0 };
    open.addEventListener("click", () => {
      if (view.wide) widen(false);
      send("open", String(row.id));
    });
    box.addEventListener("change", () => {
      box.checked ? picked.add(row.id) : picked.delete(row.id);
      draw();
      count();
    });
    image.addEventListener("load", () => node.classList.add("drawn"));
    image.addEventListener("error", () => {
      if (card.tries++ < TRIES && node.isConnected) {
        setTimeout(() => { image.src = `${card.src}&t=${card.tries}`; }, DRAWN_MS);
      }
    });
    cards.set(row.id, card);
    return card;
  };
  const fill = (card, row) => {
    const src = `/thumbnail?id=${row.id}&v=${row.state}`;
    if (card.src !== src) { card.src = src; card.tries = 0; card.node.classList.remove("drawn"); card.image.src = src; }
    const confidence = row.confidence === null ? "" : `${Math.round(100 * row.confidence)} %`;
    const state = words.shown[row.shown], person = row.assigned ? `→ ${row.assigned}` : row.who;
    const about = [state, words.colors[row.shown] && !view.wide && confidence, row.category, person];
    card.name.textContent = row.name;
    card.about.textContent = about.filter(Boolean).join(" · ");
    card.sure.textContent = confidence;
    card.open.title = `${row.name}: ${row.why ? words.because.replace("{why}", row.why) : state}`;
    card.open.setAttribute("aria-current", row.id === current);
    card.box.checked = picked.has(row.id);
    card.box.setAttribute("aria-label", `${words.pick} ${row.name}`);
    card.node.dataset.state = row.shown;
    if (words.colors[row.shown]) card.node.style.setProperty("--aw-state", words.colors[row.shown]);
  };
  const draw = () => {
    if (!root || !root.isConnected) return;
    const { width, height } = view.wide ? GALLERY : LIST;
    const across = width ? Math.max(1, Math.floor(parts.scroll.clientWidth / width)) : 1;
    if (answer.at >= 0 && followed !== current && pieces.size) {
      followed = current;
      const at = Math.floor(answer.at / across) * height, top = parts.scroll.scrollTop;
      if (at < top || at + height > top + parts.scroll.clientHeight) parts.scroll.scrollTop = at;
    }
    parts.room.style.height = `${Math.ceil(answer.total / across) * height}px`;
    const first = Math.max(0, Math.floor(parts.scroll.scrollTop / height) - 1) * across;
    const rows = Math.ceil(parts.scroll.clientHeight / height) + 2;
    const last = Math.min(first + rows * across, Math.max(answer.total, 1)) - 1;
    for (let p = Math.floor(first / PIECE); p <= Math.floor(last / PIECE); p++) ask(p);
    const seen = new Set();
    for (let k = first; k <= last; k++) {
      const row = pieces.get(Math.floor(k / PIECE))?.[k % PIECE];
      if (!row) continue;
      const card = cardOf(row), x = k % across, y = Math.floor(k / across) * height;
      fill(card, row);
      card.node.style.transform = width ? `translate(${x * width}px, ${y}px)` : `translate(0, ${y}px)`;
      if (card.node.parentElement !== parts.room) parts.room.append(card.node);
      seen.add(row.id);
    }
    for (const [id, card] of cards) if (!seen.has(id)) { card.node.remove(); cards.delete(id); }
    parts.empty.hidden = answer.total > 0 || asked.size === 0;
    parts.said.textContent = picked.size ? `${picked.size} ${words.picked}` : words.found
      .replace("{count}", answer.total).replace("{today}", answer.today);
    parts.again.hidden = !answer.stale;
    root.classList.toggle("picking", picked.size > 0);
    const counted = [...picked].filter((id) => sure.has(id)).length;
    parts.check.hidden = !mine().length;
    parts.check.textContent = words.checkThem.replace("{count}", mine().length);
    parts.accept.disabled = !counted;
    parts.accept.textContent = words.acceptSure.replace("{count}", counted);
    parts.export.disabled = !picked.size && !answer.states.accepted;
    parts.pickAll.textContent = `${words.pickAll} (${answer.total})`;
  };

  window.addEventListener("keydown", (event) => {
    if (event.key !== "Escape" || !view.wide) return;
    event.stopImmediatePropagation();
    widen(false);
  }, true);

  window.__artiworldQueue = {
    start(texts) { words = texts; settle(); },
    changed(object) { current = object; draw(); soon(again); },
    widen: () => root && widen(!view.wide),
    people(names) {
      root.classList.toggle("assigning", names.length > 0);
      parts.people.replaceChildren(...names.map(option));
    },
  };
})();
