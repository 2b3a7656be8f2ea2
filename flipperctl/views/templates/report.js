"use strict";
(() => {
  const data = JSON.parse(document.getElementById("traces").textContent);
  if (!data.traces.length) return;
  const NAMESPACE = "http://www.w3.org/2000/svg";
  const MARGIN = 60; // level ground before and past a profile, and below it [m]
  const find = (id) => document.getElementById(id);

  function element(name, attributes, parent) {
    const made = document.createElementNS(NAMESPACE, name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    if (parent) parent.append(made);
    return made;
  }

  // Traces: differences of thousandths become metres, radians and seconds.
  const summed = (steps) => { let sum = 0; return steps.map((step) => (sum += step) / 1000); };
  for (const trace of data.traces) {
    trace.moved = ["x", "z", "pitch", "front", "rear", "far_front", "far_rear"].filter((key) => trace[key]);
    for (const key of ["t", ...trace.moved]) trace[key] = summed(trace[key]);
    find("sides").hidden &&= !trace.far_front;
    trace.end = trace.t[trace.t.length - 1];
    let sum = 0; // pitch variation so far [rad]
    trace.rocked = trace.pitch.map((pitch, i) => (sum += i ? Math.abs(pitch - trace.pitch[i - 1]) : 0));
    trace.points = data.grounds[trace.ground].map(([x, z]) => [x / 1000, z / 1000]);
  }

  function before(times, time) { // index of the last time that is not later
    let low = 0, high = times.length - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (times[middle] <= time + 1e-9) low = middle; else high = middle - 1;
    }
    return low;
  }

  function pose(trace, time) {
    const at = before(trace.t, time), next = Math.min(at + 1, trace.t.length - 1);
    const span = trace.t[next] - trace.t[at];
    const part = span > 0 ? Math.min(1, Math.max(0, (time - trace.t[at]) / span)) : 0;
    const found = {};
    for (const key of [...trace.moved, "rocked"]) {
      found[key] = trace[key][at] + part * (trace[key][next] - trace[key][at]);
    }
    return found;
  }

  // Drawing; z points up, and SVG's y down.
  function drawGround(parent, points) {
    const low = Math.min(...points.map((point) => point[1])) - MARGIN;
    const [first, last] = [points[0], points[points.length - 1]];
    const line = [[first[0] - MARGIN, low], [first[0] - MARGIN, first[1]], ...points,
      [last[0] + MARGIN, last[1]], [last[0] + MARGIN, low]];
    element("path", {class: "earth", d: `M${line.map(([x, z]) => `${x} ${-z}`).join("L")}Z`}, parent);
  }

  class Robot {
    constructor(parent, {robot: [hinge, axle, radius], far_front}) {
      this.sizes = [hinge, axle];
      this.group = element("g", {}, parent);
      const near = ["chassis", "front", "rear"], parts = far_front ? ["front", "rear", ...near] : near;
      this.lines = parts.map((name) => [["belt", 2], [name, 1.44]].map(([kind, width]) =>
        element("line", {class: kind, "stroke-width": width * radius}, this.group)));
      this.hinges = [0, 1].map(() => element("circle", {class: "hinge", r: 0.3 * radius}, this.group));
    }

    show({x, z, pitch, front, rear, far_front, far_rear}) {
      const [hinge, axle] = this.sizes;
      const ahead = (from, length, angle) =>
        [from[0] + length * Math.cos(angle), from[1] + length * Math.sin(angle)];
      const nose = ahead([x, z], hinge, pitch), tail = ahead([x, z], -hinge, pitch);
      const flippers = (front, rear) => [[nose, ahead(nose, axle, pitch + front)], [ahead(tail, -axle, pitch - rear), tail]];
      const ends = [...(far_front === undefined ? [] : flippers(far_front, far_rear)), [tail, nose], ...flippers(front, rear)];
      ends.forEach(([a, b], part) => {
        for (const line of this.lines[part]) {
          const place = {x1: a[0], y1: -a[1], x2: b[0], y2: -b[1]};
          for (const [key, value] of Object.entries(place)) line.setAttribute(key, value.toFixed(4));
        }
      });
      [nose, tail].forEach((at, index) => {
        this.hinges[index].setAttribute("cx", at[0]);
        this.hinges[index].setAttribute("cy", -at[1]);
      });
    }
  }

  function poster(svg, trace) {
    const last = pose(trace, trace.end);
    svg.setAttribute("viewBox", `${last.x - 1.7} ${-last.z - 1.0} 3.4 1.7`);
    drawGround(svg, trace.points);
    for (const [ago, opacity] of [[6, 0.2], [3, 0.45], [0, 1]]) {
      if (ago > trace.end) continue;
      const robot = new Robot(svg, trace);
      robot.group.setAttribute("opacity", opacity);
      robot.show(pose(trace, trace.end - ago));
    }
  }

  // The player
  const degrees = (angle) => `${angle < -0.0087 ? "−" : ""}${Math.abs(angle * 180 / Math.PI).toFixed(0)}°`;

  // The box that holds all poses and the ground below them, (left, right, low, high) [m].
  function extent(traces) {
    const x = traces.flatMap((trace) => trace.x), z = traces.flatMap((trace) => trace.z);
    const [left, right] = [Math.min(...x) - 1, Math.max(...x) + 1];
    const ground = traces.flatMap((trace) => trace.points)
      .filter((point) => point[0] > left && point[0] < right).map((point) => point[1]);
    return [left, right, Math.min(...z, ...ground) - 0.36, Math.max(...z, ...ground) + 0.7];
  }

  class Stage {
    constructor(parent, trace, end, box, seek) {
      Object.assign(this, {trace, end, box});
      const policy = data.policies[trace.policy];
      this.node = document.createElement("div");
      this.node.className = "stage";
      this.node.innerHTML = `<h3><span><i class="dot"></i><b></b></span><span class="badge"></span>
        <span class="numbers"></span></h3><svg class="scene" role="img"></svg>
        <div class="plot"><svg preserveAspectRatio="none" aria-hidden="true"></svg></div>`;
      parent.append(this.node);
      const query = (selector) => this.node.querySelector(selector);
      query(".dot").style.setProperty("--c", `var(--${data.colours[trace.policy]})`);
      query("b").textContent = policy;
      const badge = query(".badge");
      badge.textContent = trace.outcome === "reached" ? `reached after ${trace.end.toFixed(1)} s` : `${trace.outcome} at ${trace.end.toFixed(1)} s`;
      badge.classList.toggle("failed", trace.outcome !== "reached");
      this.numbers = query(".numbers");
      this.scene = query("svg.scene");
      this.scene.setAttribute("aria-label", `${policy} on ${trace.scene}, from the side`);
      this.drawScene();
      this.drawCurves(query(".plot"), query(".plot svg"), seek);
    }

    drawScene() {
      const {trace, scene} = this;
      drawGround(scene, trace.points);
      const walked = trace.x.map((x, i) => `${x} ${-trace.z[i]}`).join("L");
      element("path", {class: "path", d: `M${walked}`}, scene);
      this.robot = new Robot(scene, trace);
      this.seen = element("path", {class: "seen"}, scene);
      this.ruler = element("g", {}, scene);
      element("line", {class: "scale", x1: 0, x2: 1, y1: 0, y2: 0}, this.ruler);
      element("text", {class: "scale-text", x: 0, y: -0.06}, this.ruler).textContent = "1 m";
    }

    drawCurves(plot, svg, seek) {
      const {trace, end} = this;
      const most = Math.max(Math.PI / 3, ...trace.moved.slice(2).flatMap((key) => trace[key].map(Math.abs))) * 1.05;
      svg.setAttribute("viewBox", `0 ${-most} ${end} ${2 * most}`);
      const line = (x1, x2, y1, y2, kind) => element("line", {class: kind, x1, x2, y1, y2}, svg);
      for (const angle of [-60, -30, 0, 30, 60]) {
        const y = -angle * Math.PI / 180;
        line(0, end, y, y, "grid");
        if (angle % 60) continue;
        const label = document.createElement("span");
        label.textContent = degrees(-y);
        label.style.top = `calc(7.5rem * ${(y + most) / (2 * most)})`;
        plot.append(label);
      }
      for (let time = 10; time < end; time += 10) line(time, time, -most, most, "grid");
      for (const key of [...trace.moved.slice(2)].reverse()) {
        const points = trace[key].map((value, i) => `${trace.t[i]},${-value}`).join(" ");
        const [name, far] = [key.replace("far_", ""), key.startsWith("far_") ? " far" : ""];
        element("polyline", {class: (name === "pitch" ? "chassis" : name) + far, points}, svg);
      }
      this.cursor = line(0, 0, -most, most, "cursor");
      const ends = document.createElement("span");
      ends.className = "end";
      for (const text of ["0 s", `${end.toFixed(1)} s`]) {
        ends.append(Object.assign(document.createElement("small"), {textContent: text}));
      }
      plot.append(ends);
      const at = (event) => {
        const box = svg.getBoundingClientRect();
        seek(Math.min(1, Math.max(0, (event.clientX - box.left) / box.width)) * end);
      };
      svg.addEventListener("pointerdown", (event) => { svg.setPointerCapture(event.pointerId); at(event); });
      svg.addEventListener("pointermove", (event) => { if (event.buttons) at(event); });
    }

    show(time, perceived) {
      const {trace} = this, clock = Math.min(time, trace.end), now = pose(trace, clock);
      this.robot.show(now);
      this.aim(now);
      this.cursor.setAttribute("x1", clock);
      this.cursor.setAttribute("x2", clock);
      this.numbers.textContent =
        `pitch ${degrees(now.pitch)} · front ${degrees(now.front)} · rear ${degrees(now.rear)} · rocked ${now.rocked.toFixed(2)} rad` +
        (trace.risk ? ` · risk ${trace.risk[before(trace.decided, clock)].toFixed(2)}` : "");
      this.seen.setAttribute("d", perceived ? this.heights(clock) : "");
    }

    aim({x, z}) { // the whole box if it fits, else what is around the robot
      const [first, last, low, high] = this.box, wide = Math.min(9, Math.max(3.8, this.node.clientWidth / 78));
      const tall = Math.min(0.42 * wide, Math.max(0.25 * wide, high - low));
      const left = last - first <= wide ? (first + last - wide) / 2
        : Math.min(last - wide, Math.max(first, x - wide * 0.45));
      const top = high - low <= tall ? low + tall
        : Math.max(low + tall, Math.min(high, z + tall * 0.55));
      this.scene.setAttribute("viewBox", `${left.toFixed(3)} ${(-top).toFixed(3)} ${wide} ${tall.toFixed(3)}`);
      this.ruler.setAttribute("transform", `translate(${left + 0.15} ${-top + tall - 0.08})`);
    }

    heights(time) {
      const {trace} = this, at = before(trace.decided, time), from = pose(trace, trace.decided[at]);
      const row = trace.heights[at] ?? [], left = from.x - row.length * trace.bin / 2;
      return row.map((height, i) => height === null ? "" :
        `M${left + (i + 0.06) * trace.bin} ${-(from.z + height / 100)}h${0.88 * trace.bin}`).join("");
    }
  }

  const choice = {scene: find("scene"), episode: find("episode"), one: find("one"), two: find("two")};
  const slider = find("time"), clock = find("clock"), play = find("play"), speed = find("speed");
  let stages = [], now = 0, end = 0, playing = false, drawn = 0;

  function fill(select, options, wanted) {
    select.replaceChildren(...options.map(([value, text]) => new Option(text, value)));
    if (options.some(([value]) => String(value) === String(wanted))) select.value = wanted;
    select.disabled = options.length < 2;
  }

  const unique = (values) => [...new Set(values)];
  const inScene = () => data.traces.filter((trace) => trace.scene === choice.scene.value);

  function chooseScene() {
    const failed = (episode) => inScene().some((t) => t.episode === episode && t.outcome !== "reached");
    const episodes = unique(inScene().map((trace) => trace.episode)).sort((a, b) => a - b);
    fill(choice.episode, episodes.map((e) => [e, `${e}${failed(e) ? " (a failure)" : ""}`]), choice.episode.value);
    chooseEpisode();
  }

  function chooseEpisode() {
    const [one, two] = [choice.one.value, choice.two.value];
    const there = data.policies.map((name, index) => [index, name]).filter(([index]) => traceOf(index));
    fill(choice.one, there, one);
    fill(choice.two, [["", "none"], ...there], two);
    if (choice.two.value === choice.one.value) choice.two.value = "";
    const other = there.find(([index]) => index === data.beside) ?? there[1];
    if (two === "" && one === "" && other && other !== there[0]) choice.two.value = other[0];
    choosePolicies();
  }

  const traceOf = (policy) => policy === "" ? undefined : data.traces.find((trace) =>
    trace.scene === choice.scene.value && trace.episode === Number(choice.episode.value) &&
    trace.policy === Number(policy));

  function choosePolicies() {
    pause();
    find("stages").replaceChildren();
    const chosen = unique([traceOf(choice.one.value), traceOf(choice.two.value)]).filter(Boolean);
    end = Math.max(...chosen.map((trace) => trace.end));
    const seek = (time) => { pause(); show(time); };
    stages = chosen.map((trace) => new Stage(find("stages"), trace, end, extent(chosen), seek));
    slider.max = end;
    show(Math.min(now, end));
  }

  function show(time) {
    now = Math.min(end, Math.max(0, time));
    for (const stage of stages) stage.show(now, find("perceived").checked);
    slider.value = now;
    clock.textContent = `${now.toFixed(1)} of ${end.toFixed(1)} s`;
    slider.setAttribute("aria-valuetext", clock.textContent);
  }

  function step(at) {
    if (!playing) return;
    show(now + (at - drawn) / 1000 * Number(speed.value));
    drawn = at;
    if (now >= end) pause(); else requestAnimationFrame(step);
  }

  function pause() { playing = false; label(); }
  function label() { play.textContent = playing ? "❚❚ Pause" : "▶ Play"; }
  function toggle() {
    playing = !playing;
    if (playing && now >= end) now = 0;
    label();
    drawn = performance.now();
    if (playing) requestAnimationFrame(step);
  }

  fill(choice.scene, unique(data.traces.map((trace) => trace.scene)).map((name) => [name, name]), "");
  choice.scene.addEventListener("change", () => { now = 0; chooseScene(); });
  choice.episode.addEventListener("change", () => { now = 0; chooseEpisode(); });
  choice.one.addEventListener("change", choosePolicies);
  choice.two.addEventListener("change", choosePolicies);
  slider.addEventListener("input", () => { pause(); show(Number(slider.value)); });
  find("perceived").addEventListener("change", () => show(now));
  play.addEventListener("click", toggle);
  find("player").addEventListener("keydown", (event) => {
    const seconds = {ArrowLeft: -1, ArrowRight: 1}[event.key] * (event.shiftKey ? 0.1 : 0.6);
    const ends = {Home: 0, End: end}[event.key];
    const typed = event.target.tagName === "SELECT" || event.ctrlKey || event.metaKey || event.altKey;
    if (typed) return;
    if (event.key === " " && !["BUTTON", "INPUT"].includes(event.target.tagName)) toggle();
    else if (event.key === " " && event.target === slider) toggle();
    else if (!Number.isNaN(seconds)) { pause(); show(now + seconds); }
    else if (ends !== undefined) { pause(); show(ends); }
    else return;
    event.preventDefault();
  });
  window.addEventListener("resize", () => show(now));
  window.addEventListener("beforeprint", () => { if (now === 0) show(0.4 * end); });

  for (const svg of document.querySelectorAll("svg.poster")) poster(svg, data.traces[Number(svg.dataset.trace)]);
  for (const button of document.querySelectorAll("button[data-trace]")) {
    button.addEventListener("click", () => {
      const trace = data.traces[Number(button.dataset.trace)];
      choice.scene.value = trace.scene;
      chooseScene();
      choice.episode.value = trace.episode;
      chooseEpisode();
      choice.one.value = trace.policy;
      if (choice.two.value === choice.one.value) choice.two.value = "";
      now = 0;
      choosePolicies();
      find("player").scrollIntoView({block: "start"});
      find("player").focus({preventScroll: true});
      toggle();
    });
  }
  chooseScene();
  label();
})();
