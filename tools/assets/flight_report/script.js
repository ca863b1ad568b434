"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const $ = (id) => document.getElementById(id);
  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const text = (parent, tag, content, attributes = {}) => {
    const node = document.createElement(tag);
    node.textContent = content;
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    parent.appendChild(node);
    return node;
  };
  const WHO = data.who_names;
  const COLOUR = { actor: "--actor", "geometric pilot": "--geometric", "recovery pilot": "--recovery", hold: "--hold" };
  const colour = (who) => css(COLOUR[WHO[who]] || "--idle");
  const date = (s) => `${new Date(1000 * s).toISOString().slice(0, 19).replace("T", " ")} UTC`;
  const seconds = (t) => `${t.toFixed(2)} s`;

  // Header and facts.
  document.title = data.title;
  $("title").textContent = data.title;
  $("verdict").textContent = data.verdict.text;
  $("verdict").className = data.verdict.good ? "good" : "bad";
  for (const note of data.notes) text($("notes"), "li", note);
  for (const [name, value] of data.facts) {
    const pair = text($("facts"), "div", "");
    text(pair, "dt", name);
    text(pair, "dd", name === "Began" ? date(value) : value);
  }
  if (data.command) {
    $("command").textContent = data.command;
    $("copy").onclick = () => navigator.clipboard && navigator.clipboard.writeText(data.command);
  } else $("command-row").hidden = true;
  $("config").textContent = data.config;
  $("footer").textContent = data.footer;

  // Spans of time in which something is the case.
  const spansOf = (values, is) => {
    const spans = [];
    for (let i = 0; i < values.length; i++) {
      if (!is(values[i])) continue;
      const last = spans[spans.length - 1];
      const end = data.t[Math.min(i + 1, data.t.length - 1)];
      if (last && last[2] === i - 1) { last[1] = end; last[2] = i; }
      else spans.push([data.t[i], end, i]);
    }
    return spans;
  };
  const named = (name) => WHO.indexOf(name);
  const bands = [
    ["--band-hold", "holding", spansOf(data.who, (w) => w === named("hold"))],
    ["--band-recovery", "recovery pilot flies", spansOf(data.who, (w) => w === named("recovery pilot"))],
    ["--band-attack", "frames altered", data.attack ? spansOf(data.attack, (a) => a === 1) : []],
  ];
  const key = (parent, background, words) => {
    const node = text(parent, "span", "", { class: "key" });
    text(node, "i", "").style.background = background;
    node.appendChild(document.createTextNode(words));
  };
  for (const [name, words, spans] of bands) if (spans.length) key($("bands"), css(name), words);

  // One moment for all: plots, map and film follow it.
  const followers = [];
  let moment = null;
  const goTo = (t, from) => {
    moment = t;
    for (const follow of followers) if (follow !== from) follow(t);
  };
  const indexAt = (t) => {
    let low = 0, high = data.t.length - 1;
    while (high - low > 1) { const mid = (low + high) >> 1; if (data.t[mid] <= t) low = mid; else high = mid; }
    return high >= 0 && Math.abs(data.t[high] - t) < Math.abs(data.t[low] - t) ? high : low;
  };

  // Plots.
  const plots = [];
  let syncing = false;
  const apart = (draw) => (u) => {
    u.ctx.save();
    draw(u, u.ctx, u.bbox);
    u.ctx.restore();
  };
  const drawBands = apart((u, ctx, bbox) => {
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    for (const [name, , spans] of bands) {
      ctx.fillStyle = css(name);
      for (const [from, to] of spans) {
        const x = u.valToPos(from, "x", true);
        ctx.fillRect(x, bbox.top, Math.max(1, u.valToPos(to, "x", true) - x), bbox.height);
      }
    }
  });
  const drawAlarms = apart((u, ctx, bbox) => {
    ctx.strokeStyle = css("--bad");
    ctx.setLineDash([5, 4]);
    ctx.lineWidth = Math.max(1, devicePixelRatio);
    for (const [t] of data.alarms) {
      const x = u.valToPos(t, "x", true);
      if (x < bbox.left || x > bbox.left + bbox.width) continue;
      ctx.beginPath();
      ctx.moveTo(x, bbox.top);
      ctx.lineTo(x, bbox.top + bbox.height);
      ctx.stroke();
    }
  });
  const makePlot = (panel) => {
    const box = text($("plots"), "div", "", { class: "plot", "data-panel": panel.id });
    text(box, "h3", panel.title);
    const columns = panel.series.map((s) => data.columns[s.column]);
    if (!columns.some((c) => c && c.some((v) => v !== null))) {
      text(box, "p", panel.none, { class: "none" });
      return;
    }
    const axis = { stroke: css("--text"), grid: { stroke: css("--line"), width: 1 }, ticks: { stroke: css("--line"), width: 1 }, font: "12px system-ui, sans-serif", labelFont: "12px system-ui, sans-serif", labelSize: 18 };
    const options = {
      width: Math.max(240, box.clientWidth), height: 210,
      cursor: { sync: { key: "flight", setSeries: false }, drag: { x: true, y: false } },
      scales: { x: { time: false }, y: panel.range ? { range: panel.range } : {} },
      axes: [{ ...axis, size: 36, label: "time since the first step (s)" }, { ...axis, size: 50, label: panel.unit }],
      series: [{ label: "t", value: (u, v) => (v == null ? "–" : seconds(v)) },
        ...panel.series.map((s, i) => ({
          label: s.label, stroke: css(`--s${i + 1}`), width: s.dashed ? 1.2 : 1.6, dash: s.dashed ? [6, 4] : undefined, spanGaps: false, points: { show: false },
          value: (u, v) => (v == null ? "–" : v.toFixed(s.decimals)),
        }))],
      hooks: {
        drawClear: [drawBands], draw: [drawAlarms],
        setCursor: [(u) => { if (u.cursor.idx != null && u.over.matches(":hover")) goTo(data.t[u.cursor.idx], followPlots); }],
        setScale: [(u, key) => {
          if (key !== "x" || syncing) return;
          syncing = true;
          const { min, max } = u.scales.x;
          for (const other of plots) if (other !== u) other.setScale("x", { min, max });
          drawHeat(min, max);
          syncing = false;
        }],
      },
    };
    const plot = new uPlot(options, [data.t, ...columns], box);
    plot.vigilBox = box;
    plots.push(plot);
  };
  const followPlots = (t) => {
    for (const plot of plots) plot.setCursor({ left: plot.valToPos(t, "x"), top: -10 }, false);
  };
  followers.push(followPlots);

  // The 48 explained values, a column of pixels for each step.
  let heat = null;
  const diverging = (v) => {
    // Blue below zero, orange above, white (or the page's dark) at zero: safe for the colour-blind.
    const dark = matchMedia("(prefers-color-scheme: dark)").matches;
    const zero = dark ? [24, 28, 33] : [255, 255, 255];
    const end = v < 0 ? (dark ? [86, 180, 233] : [0, 90, 160]) : (dark ? [255, 150, 60] : [200, 80, 0]);
    const share = Math.min(1, Math.abs(v));
    return zero.map((z, i) => Math.round(z + (end[i] - z) * share));
  };
  const drawHeat = (min, max) => {
    if (!heat) return;
    const { canvas, values, rows } = heat;
    const from = indexAt(min), to = Math.max(from + 1, indexAt(max));
    canvas.width = to - from + 1;
    canvas.height = rows;
    const ctx = canvas.getContext("2d");
    const image = ctx.createImageData(canvas.width, rows);
    for (let x = 0; x < canvas.width; x++) for (let y = 0; y < rows; y++) {
      const code = values[(from + x) * rows + y];
      const [r, g, b] = code === -128 ? [128, 128, 128] : diverging(code / 127);
      image.data.set([r, g, b, 255], 4 * (y * canvas.width + x));
    }
    ctx.putImageData(image, 0, 0);
  };
  const makeHeat = () => {
    const box = text($("plots"), "div", "", { class: "plot", "data-panel": "explanation" });
    text(box, "h3", "Explanation: SHAP of the hidden layer's 48 values for the yaw output");
    if (!data.phi) { text(box, "p", "No explanations: no detector monitored an actor in this flight.", { class: "none" }); return; }
    const bytes = Uint8Array.from(atob(data.phi.values), (c) => c.charCodeAt(0));
    heat = { canvas: text(box, "canvas", "", { class: "heat" }), values: new Int8Array(bytes.buffer), rows: data.phi.rows };
    text(box, "p", `A row for each value, a column for each step. Orange turns right, blue left; full colour is ±${data.phi.full.toPrecision(2)} action units. Grey: none in that step.`, { class: "hint" });
    if (data.t.length) drawHeat(data.t[0], data.t[data.t.length - 1]);
  };

  // The map: x is east, y is north.
  const svg = (parent, tag, attributes) => {
    const node = document.createElementNS("http://www.w3.org/2000/svg", tag);
    for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
    parent.appendChild(node);
    return node;
  };
  const makeMap = () => {
    const map = data.map, root = $("map");
    const { north, east } = { north: data.columns.north_m, east: data.columns.east_m };
    const known = north.map((n, i) => (n === null ? -1 : i)).filter((i) => i >= 0);
    if (!known.length && !map.solids.length) { $("map-none").textContent = "No position was ever received and the log holds no obstacles."; root.remove(); return; }
    const points = known.map((i) => [east[i], -north[i]]).concat(map.truth.map(([n, e]) => [e, -n]));
    if (map.goal) points.push([map.goal[1], -map.goal[0]]);
    for (const s of map.solids) points.push(...s.map(([n, e]) => [e, -n]));
    let [x0, x1] = [Math.min(...points.map((p) => p[0])) - 1.5, Math.max(...points.map((p) => p[0])) + 1.5];
    let [y0, y1] = [Math.min(...points.map((p) => p[1])) - 1.5, Math.max(...points.map((p) => p[1])) + 1.5];
    // A long course is wide enough that its letters fit.
    const long = Math.max(x1 - x0, y1 - y0), lacks = Math.max(0, 0.6 * long - (x1 - x0)) / 2;
    [x0, x1] = [x0 - lacks, x1 + lacks];
    root.setAttribute("viewBox", `${x0} ${y0} ${x1 - x0} ${y1 - y0}`);
    root.style.maxHeight = "640px";
    const step = [5, 10, 20, 50, 100].find((s) => long / s <= 9) || 200;
    const size = long / 45;
    for (let x = Math.ceil(x0 / step) * step; x <= x1; x += step) {
      svg(root, "line", { x1: x, x2: x, y1: y0, y2: y1, stroke: css("--line"), "stroke-width": size / 14 });
      svg(root, "text", { x: x + size / 5, y: y1 - size / 4, "font-size": size, fill: css("--soft") }).textContent = `${x} m E`;
    }
    for (let y = Math.ceil(y0 / step) * step; y <= y1; y += step) {
      svg(root, "line", { x1: x0, x2: x1, y1: y, y2: y, stroke: css("--line"), "stroke-width": size / 14 });
      if (y < y1 - 2 * size) svg(root, "text", { x: x0 + size / 5, y: y - size / 5, "font-size": size, fill: css("--soft") }).textContent = `${-y} m N`;
    }
    for (const s of map.solids) svg(root, "polygon", { points: s.map(([n, e]) => `${e},${-n}`).join(" "), fill: css("--solid"), stroke: css("--soft"), "stroke-width": size / 16 });
    if (map.goal) {
      svg(root, "circle", { cx: map.goal[1], cy: -map.goal[0], r: 1, fill: "none", stroke: css("--goal"), "stroke-width": size / 5 });
      svg(root, "circle", { cx: map.goal[1], cy: -map.goal[0], r: size / 4, fill: css("--goal") });
    }
    const line = (indices, stroke, width, extra = {}) => svg(root, "polyline", { points: indices.map((i) => `${east[i]},${-north[i]}`).join(" "), fill: "none", stroke, "stroke-width": width, "stroke-linejoin": "round", "stroke-linecap": "round", ...extra });
    const runs = (value) => {
      const out = [];
      for (const i of known) {
        const last = out[out.length - 1];
        if (last && last.value === value(i) && last.indices[last.indices.length - 1] === i - 1) last.indices.push(i);
        else out.push({ value: value(i), indices: last && last.indices[last.indices.length - 1] === i - 1 ? [i - 1, i] : [i] });
      }
      return out;
    };
    // Under the path, where frames were altered: wide and pale, so that it says so for whoever flies.
    if (data.attack) for (const run of runs((i) => data.attack[i])) if (run.value === 1) line(run.indices, css("--attack"), size * 0.95, { opacity: 0.38 });
    if (map.truth.length) svg(root, "polyline", { points: map.truth.map(([n, e]) => `${e},${-n}`).join(" "), fill: "none", stroke: css("--truth"), "stroke-width": size / 9, "stroke-dasharray": `${size / 2.5} ${size / 2.5}` });
    const flew = new Set();
    for (const run of runs((i) => data.who[i])) { flew.add(run.value); line(run.indices, colour(run.value), size / 3.2); }
    for (const [t, cause] of data.alarms) {
      const i = indexAt(t);
      if (north[i] === null) continue;
      const [x, y, r] = [east[i], -north[i], size * 0.55];
      svg(svg(root, "path", { d: `M${x} ${y - r} L${x + r} ${y + r * 0.8} L${x - r} ${y + r * 0.8} Z`, fill: css("--bad"), stroke: css("--bg"), "stroke-width": size / 10 }), "title", {}).textContent = `alarm: ${cause}`;
    }
    const here = svg(root, "g", { opacity: 0 });
    svg(here, "path", { d: `M0 ${-size} L${size * 0.65} ${size * 0.7} L0 ${size * 0.3} L${-size * 0.65} ${size * 0.7} Z`, fill: css("--text"), stroke: css("--bg"), "stroke-width": size / 10 });
    const follow = (t) => {
      const i = indexAt(t);
      if (north[i] === null) { here.setAttribute("opacity", 0); return; }
      here.setAttribute("opacity", 1);
      here.setAttribute("transform", `translate(${east[i]} ${-north[i]}) rotate(${data.columns.heading_deg[i] || 0})`);
    };
    followers.push(follow);
    const nearest = (event) => {
      const at = root.createSVGPoint();
      [at.x, at.y] = [event.clientX, event.clientY];
      const p = at.matrixTransform(root.getScreenCTM().inverse());
      let best = null, least = Infinity;
      for (const i of known) { const d = (east[i] - p.x) ** 2 + (-north[i] - p.y) ** 2; if (d < least) { least = d; best = i; } }
      if (best !== null) goTo(data.t[best]);
    };
    root.addEventListener("click", nearest);
    const legend = $("map-legend");
    const said = new Map();
    for (const who of [...flew].sort()) said.set(colour(who), [...(said.get(colour(who)) || []), WHO[who]]);
    for (const [stroke, names] of said) key(legend, stroke, names.join(", "));
    if (data.attack && data.attack.includes(1)) key(legend, css("--attack"), "frames altered");
    if (data.alarms.length) key(legend, css("--bad"), "alarm raised");
    if (map.truth.length) key(legend, css("--truth"), "true path (dashed)");
    if (map.goal) key(legend, css("--goal"), "goal");
  };

  // The film.
  const makeFilm = () => {
    const frames = data.frames, slider = $("slider");
    if (!frames.length) { $("film-none").textContent = data.film_none; $("film").hidden = true; return; }
    slider.max = frames.length - 1;
    const strip = frames.map((frame, i) => {
      const img = text($("strip"), "img", "", { src: frame.depth, alt: `Frame at ${seconds(frame.t)}`, role: "listitem", title: seconds(frame.t) });
      img.style.borderBottomColor = frame.altered ? css("--attack") : colour(frame.who);
      img.onclick = () => show(i, true);
      return img;
    });
    let now = -1;
    const show = (i, lead) => {
      if (i === now) return;
      if (now >= 0) strip[now].classList.remove("now");
      now = i;
      const frame = frames[i];
      slider.value = i;
      strip[i].classList.add("now");
      const box = $("strip");
      box.scrollTop = strip[i].offsetTop - box.clientHeight / 2;
      $("img-depth").src = frame.depth;
      $("img-depth").className = frame.altered ? "altered" : "";
      for (const [id, picture] of [["clean", frame.clean], ["shap", frame.shap]]) {
        $(`fig-${id}`).style.display = frames.some((f) => f[id]) ? "" : "none";
        $(`img-${id}`).style.visibility = picture ? "" : "hidden";
        if (picture) $(`img-${id}`).src = picture;
      }
      $("film-text").textContent = frame.text;
      if (lead) goTo(frame.t, follow);
    };
    const follow = (t) => {
      let best = 0;
      for (let i = 1; i < frames.length; i++) if (Math.abs(frames[i].t - t) < Math.abs(frames[best].t - t)) best = i;
      show(best, false);
    };
    followers.push(follow);
    slider.oninput = () => show(Number(slider.value), true);
    let playing = null;
    $("play").onclick = () => {
      if (playing) { clearInterval(playing); playing = null; $("play").textContent = "▶"; return; }
      $("play").textContent = "⏸";
      if (now >= frames.length - 1) show(0, true);
      playing = setInterval(() => { if (now >= frames.length - 1) $("play").onclick(); else show(now + 1, true); }, 120);
    };
    // Where the plots are laid out, they have a place for it.
    requestAnimationFrame(() => show(Math.max(0, data.first_frame), true));
  };

  // Events.
  if (!data.events.length) { $("events-none").textContent = "The log tells of no event."; $("events").hidden = true; }
  for (const { t, weight, text: words } of data.events) {
    const row = text($("events").tBodies[0], "tr", "", { class: weight, "data-t": t });
    text(row, "td", seconds(t));
    text(row, "td", words);
    row.onclick = () => goTo(t);
  }

  for (const panel of data.panels) { makePlot(panel); if (panel.id === "contributions") makeHeat(); }
  makeMap();
  makeFilm();
  new ResizeObserver(() => requestAnimationFrame(() => { for (const plot of plots) plot.setSize({ width: Math.max(240, plot.vigilBox.clientWidth), height: 210 }); })).observe($("plots"));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => location.reload());
  document.documentElement.dataset.ready = plots.length;
})();
