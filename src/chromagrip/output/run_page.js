"use strict";
// Draws the curves of all runs over time, and keeps slider, curves and videos at one instant.
(() => {
  const runs = JSON.parse(document.getElementById("data").textContent);
  const slider = document.getElementById("time");
  const button = document.getElementById("play");
  const speed = document.getElementById("speed");
  const output = document.getElementById("now");
  const svgNamespace = "http://www.w3.org/2000/svg";
  const several = runs.length > 1;
  // Okabe and Ito's colours, which people with any colour vision tell apart.
  const roleColours = { true: "var(--blue)", estimated: "var(--red)", commanded: "var(--blue)", other: "var(--soft)" };
  const runColours = ["var(--blue)", "var(--red)", "#009e73", "#cc79a7", "#e69f00", "#999999"];
  const height = 170;
  const margin = { left: 46, right: 14, top: 8, bottom: 20 };
  const last = Math.max(...runs.map((run) => run.time[run.time.length - 1] || 0), 1e-9);
  let now = 0;

  function element(name, attributes, parent) {
    const made = document.createElementNS(svgNamespace, name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    if (parent) parent.append(made);
    return made;
  }

  function style(curve, run) {
    const width = curve.role === "estimated" ? 1.4 : 2.2;
    const dashes = { true: ["", "7 3"], commanded: ["", "7 3"], estimated: ["4 2", "1 3"], other: [several ? "1 3" : "", "2 3"] };
    return {
      stroke: several ? runColours[run % runColours.length] : roleColours[curve.role],
      "stroke-width": width,
      "stroke-dasharray": dashes[curve.role][curve.second ? 1 : 0],
      fill: "none",
    };
  }

  // Largest index whose time is not after t.
  function indexAt(time, t) {
    let low = 0;
    let high = time.length - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (time[middle] <= t + 1e-9) low = middle;
      else high = middle - 1;
    }
    return low;
  }

  function path(time, values, x, y, steps) {
    let text = "";
    let open = false;
    for (let i = 0; i < values.length; i++) {
      if (values[i] === null) {
        open = false;
        continue;
      }
      const at = `${x(time[i]).toFixed(1)},${y(values[i]).toFixed(1)}`;
      if (open && steps) text += `H${x(time[i]).toFixed(1)}`;
      text += (open ? "L" : "M") + at;
      open = true;
    }
    return text;
  }

  function band(time, [low, high], x, y) {
    let text = "";
    let first = 0;
    for (let i = 0; i <= low.length; i++) {
      if (i < low.length && low[i] !== null && high[i] !== null) continue;
      if (i > first + 1) {
        const there = [];
        const back = [];
        for (let k = first; k < i; k++) {
          there.push(`${x(time[k]).toFixed(1)},${y(high[k]).toFixed(1)}`);
          back.unshift(`${x(time[k]).toFixed(1)},${y(low[k]).toFixed(1)}`);
        }
        text += `M${there.join("L")}L${back.join("L")}Z`;
      }
      first = i + 1;
    }
    return text;
  }

  function ticks(low, high, most) {
    const rough = (high - low) / most;
    const power = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map((f) => f * power).find((s) => s >= rough);
    const found = [];
    for (let v = Math.ceil(low / step - 1e-9) * step; v <= high + 1e-9 * step; v += step) found.push(v);
    const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    return found.map((v) => [v, v.toFixed(digits).replace(/^-(0(\.0*)?)$/, "$1")]);
  }

  // Line of a curve beside its words, over a shade where it has an interval.
  function keyOf(curve, look) {
    const key = element("svg", { viewBox: "0 0 32 12", "aria-hidden": "true" });
    if (curve.band.length) {
      element("rect", { x: 0, y: 1, width: 32, height: 10, fill: look.stroke, opacity: 0.2 }, key);
    }
    element("line", { x1: 0, y1: 6, x2: 32, y2: 6, ...look }, key);
    return key;
  }

  function made(name, parent, ...content) {
    const one = document.createElement(name);
    one.append(...content);
    parent.append(one);
    return one;
  }

  // Legend of one run: a line for each curve; returns where its value is shown.
  function legendOfOne(curves, box) {
    const legend = made("ul", box);
    legend.className = "legend";
    return curves.map(({ curve, k }) => {
      const item = made("li", legend, keyOf(curve, style(curve, k)), `${curve.label} `);
      return made("b", item);
    });
  }

  // Legend of several runs: a row for each run with its colour, a column for each line style.
  function legendOfSeveral(curves, box) {
    const wide = made("div", box);
    wide.className = "wide legend";
    const table = made("table", wide);
    // What the controller has is called estimated on one path and observed on the other.
    const columnOf = (curve) => (curve.role === "estimated" ? `estimated ${curve.second}` : curve.label);
    const columns = [...new Set(curves.map(({ curve }) => columnOf(curve)))];
    const head = made("tr", table);
    made("th", head);
    for (const column of columns) {
      const alike = curves.filter(({ curve }) => columnOf(curve) === column);
      const { curve, k } = alike.find((one) => one.curve.band.length) || alike[0];
      const both = new Set(alike.map((one) => one.curve.label)).size > 1;
      const words = both ? curve.label.replace(/estimated|observed/, "estimated / observed") : curve.label;
      made("th", head, keyOf(curve, { ...style(curve, k), stroke: "var(--ink)" }), words);
    }
    const cells = new Map();
    for (const k of new Set(curves.map((one) => one.k))) {
      const row = made("tr", table);
      const colour = element("svg", { viewBox: "0 0 32 12", "aria-hidden": "true" });
      element("rect", { x: 0, y: 2, width: 32, height: 8, fill: runColours[k % runColours.length] }, colour);
      made("th", row, colour, runs[k].name);
      for (const column of columns) cells.set(`${k} ${column}`, made("b", made("td", row)));
    }
    return curves.map(({ curve, k }) => cells.get(`${k} ${columnOf(curve)}`));
  }

  // Panels of the same scene and title share one plot; several scenes have a heading each.
  const scenes = [...new Set(runs.map((run) => run.scene))];
  const titles = scenes.flatMap((scene) => {
    const panels = runs.filter((run) => run.scene === scene).flatMap((run) => run.panels);
    return [...new Set(panels.map((panel) => panel.title))].map((title, i) => ({ scene, title, first: !i }));
  });
  const plots = titles.map(({ scene, title, first }) => {
    const parts = runs.flatMap((run, k) => run.scene !== scene ? [] :
      run.panels.filter((panel) => panel.title === title).map((panel) => ({ panel, k })));
    const curves = parts.flatMap(({ panel, k }) => panel.curves.map((curve) => ({ curve, k })));
    const levels = [];
    for (const [label, value] of parts.flatMap(({ panel }) => panel.levels)) {
      if (!levels.some(([l, v]) => l === label && v === value)) levels.push([label, value]);
    }
    const box = document.createElement("section");
    box.className = "panel";
    const heading = document.createElement("h3");
    heading.textContent = title;
    const svg = element("svg", { height, role: "img", "aria-label": title });
    box.append(heading, svg);
    const all = document.getElementById("panels");
    if (first && scenes.length > 1) made("h2", all, scene);
    all.append(box);
    const shown = (several ? legendOfSeveral : legendOfOne)(curves, box);
    if (curves.some(({ curve }) => curve.band.length)) {
      made("p", box, "shaded: 90 % interval").className = "note";
    }
    return { parts, curves, levels, svg, shown, cursor: null, x: null, digits: 3 };
  });

  function draw(plot) {
    const width = Math.max(plot.svg.clientWidth, 200);
    plot.svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    plot.svg.replaceChildren();
    let low = Math.min(...plot.parts.map(({ panel }) => panel.span[0]));
    let high = Math.max(...plot.parts.map(({ panel }) => panel.span[1]));
    for (const { curve } of plot.curves) {
      for (const v of curve.values) {
        if (v !== null) {
          low = Math.min(low, v);
          high = Math.max(high, v);
        }
      }
    }
    for (const [, level] of plot.levels) high = Math.max(high, level);
    const [least, most] = plot.parts[0].panel.limits;
    low = Math.max(low, least ?? -Infinity);
    high = Math.min(high, most ?? Infinity);
    const room = 0.05 * (high - low || 1);
    if (low < 0 || low !== 0) low -= room;
    high += room;
    const right = width - margin.right;
    const bottom = height - margin.bottom;
    const x = (t) => margin.left + (t / last) * (right - margin.left);
    const clamp = (v) => Math.min(Math.max(v, low - (high - low)), high + (high - low));
    const y = (v) => bottom - ((clamp(v) - low) / (high - low)) * (bottom - margin.top);
    const id = `clip${plots.indexOf(plot)}`;
    const clip = element("clipPath", { id }, element("defs", {}, plot.svg));
    element("rect", { x: margin.left, y: margin.top - 4, width: right - margin.left, height: bottom - margin.top + 8 }, clip);
    for (const [value, label] of ticks(low, high, 4)) {
      element("line", { x1: margin.left, x2: right, y1: y(value), y2: y(value), stroke: "var(--faint)" }, plot.svg);
      element("text", { x: margin.left - 5, y: y(value) + 4, "text-anchor": "end" }, plot.svg).textContent = label;
    }
    for (const [value, label] of ticks(0, last, width < 420 ? 4 : 8)) {
      element("line", { x1: x(value), x2: x(value), y1: bottom, y2: bottom + 4, stroke: "var(--soft)" }, plot.svg);
      element("text", { x: x(value), y: height - 4, "text-anchor": "middle" }, plot.svg).textContent = `${label} s`;
    }
    const inside = element("g", { "clip-path": `url(#${id})` }, plot.svg);
    for (const { curve, k } of plot.curves) {
      if (curve.band.length === 2) {
        element("path", { d: band(runs[k].time, curve.band, x, y), fill: style(curve, k).stroke, opacity: several ? 0.1 : 0.2 }, inside);
      }
    }
    for (const { curve, k } of plot.curves) {
      element("path", { d: path(runs[k].time, curve.values, x, y, curve.steps), ...style(curve, k) }, inside);
    }
    const labels = []; // above every line
    const places = []; // of the labels of levels; two that lie close would overprint
    for (const [label, level] of plot.levels) {
      const free = [y(level) - 4, y(level) + 12].find((at) => places.every((other) => Math.abs(other - at) >= 12));
      const place = free ?? y(level) - 4;
      places.push(place);
      element("line", { x1: margin.left, x2: right, y1: y(level), y2: y(level), stroke: "var(--ink)", "stroke-dasharray": "2 3" }, plot.svg);
      labels.push([label, { x: free === undefined ? right - 150 : right - 2, y: place, "text-anchor": "end" }]);
    }
    for (const [label, where] of labels) element("text", where, plot.svg).textContent = label;
    // A thousandth of the axis; less than that is not drawn either.
    plot.digits = Math.max(0, 3 - Math.floor(Math.log10(Math.max(Math.abs(low), Math.abs(high)))));
    plot.cursor = element("line", { y1: margin.top, y2: bottom, stroke: "var(--ink)", "stroke-width": 1 }, plot.svg);
    plot.x = x;
  }

  const videos = [...document.querySelectorAll("video")].map((video) => {
    const run = Number(video.dataset.run);
    const text = document.querySelector(`script[data-video="${run}"]`).textContent;
    const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    video.src = URL.createObjectURL(new Blob([bytes], { type: "video/mp4" }));
    return { video, run };
  });

  function show(t, follow) {
    now = Math.min(Math.max(t, 0), last);
    slider.value = now;
    slider.setAttribute("aria-valuetext", `${now.toFixed(2)} seconds`);
    output.textContent = `${now.toFixed(2)} s`;
    for (const plot of plots) {
      const at = plot.x(now);
      plot.cursor.setAttribute("x1", at);
      plot.cursor.setAttribute("x2", at);
      plot.curves.forEach(({ curve, k }, i) => {
        const value = curve.values[indexAt(runs[k].time, now)];
        plot.shown[i].textContent =
          value === null || value === undefined ? "–" : Number(value.toFixed(plot.digits)).toFixed(plot.digits);
      });
    }
    if (!follow) {
      for (const { video, run } of videos) {
        if (video.readyState > 0) video.currentTime = now * runs[run].slowdown + 0.005;
      }
    }
  }

  let playing = null; // time of the page and of the run when it began to play
  function stop() {
    playing = null;
    button.textContent = "Play";
    for (const { video } of videos) video.pause();
    show(now, false);
  }
  function play() {
    if (now >= last - 1e-9) show(0, false);
    const rate = Number(speed.value);
    playing = { page: performance.now(), run: now, rate };
    button.textContent = "Pause";
    for (const { video, run } of videos) {
      video.playbackRate = rate * runs[run].slowdown;
      video.play().catch(() => {});
    }
    requestAnimationFrame(tick);
  }
  function tick(at) {
    if (!playing) return;
    const t = playing.run + (playing.rate * (at - playing.page)) / 1000;
    show(t, true);
    if (t >= last) stop();
    else requestAnimationFrame(tick);
  }

  slider.max = last;
  slider.step = last / 1000;
  slider.addEventListener("input", () => {
    const t = Number(slider.value);
    if (playing) stop();
    show(t, false);
  });
  button.addEventListener("click", () => (playing ? stop() : play()));
  speed.addEventListener("change", () => {
    if (playing) {
      stop();
      play();
    }
  });
  document.addEventListener("keydown", (event) => {
    if (event.key === " " && event.target.tagName !== "BUTTON" && event.target.tagName !== "SELECT") {
      event.preventDefault();
      button.click();
    }
  });
  for (const plot of plots) {
    const seek = (event) => {
      if (event.type === "pointermove" && !event.buttons) return;
      const box = plot.svg.getBoundingClientRect();
      const share = (event.clientX - box.left - margin.left) / (box.width - margin.left - margin.right);
      if (playing) stop();
      show(share * last, false);
    };
    plot.svg.addEventListener("pointerdown", seek);
    plot.svg.addEventListener("pointermove", seek);
  }
  for (const { video } of videos) video.addEventListener("loadedmetadata", () => show(now, false));
  let drawnWidth = -1;
  new ResizeObserver(() => {
    if (document.body.clientWidth === drawnWidth) return;
    drawnWidth = document.body.clientWidth;
    plots.forEach(draw);
    show(now, true);
  }).observe(document.body);
  plots.forEach(draw);
  show(last, false);
})();
