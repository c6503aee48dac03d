// Images side by side over the same ground. The first one's pixels are the frame; the others follow by the Jacobian of
// the last answer of the server, at once, and by the next answer exactly.

import {withModifier} from './app.js';
import {likeFrame, ofFrame, ofOther} from './affine.js';
import {drawFrame, worstFirst} from './image_marks.js';
import {drawLaser, nearestShot} from './laser_plot.js';
import {Measuring} from './measuring.js';
import {Pane} from './pane.js';
import {button, caption, check, make, options, refill, short} from './plot.js';

const MOST = 4; // panes
const SHOWN = [
  ['ties', '+ tie, × rejected', true], ['names', 'names of ties', false], ['residuals', '— residual ×', true], ['shots', '○ △ shots', true],
  ['ellipses', '○ predicted, 95 %', true], ['outlines', '▭ other images', true], ['turned', 'turn to the first', true], ['shape', 'ground shape', false],
];
const LAYOUTS = [['along', 'Lines along the pane'], ['upright', 'Lines downwards'], ['north', 'North up']];
const COMPARED = [['', 'Side by side'], ['blink', 'Blink (b)'], ['swipe', 'Swipe (w)'], ['red', 'Red and cyan (a)']];
const LONG = 2; // times as long as wide: such images stand one above the other
const STEP = 60; // CSS pixels by which an arrow key moves

class Images {
  constructor(app, element) {
    Object.assign(this, {app, element, panes: [], center: null, zoom: 0, link: null, known: null, cursor: [0, 0], shown: {}});
    Object.assign(this, {compare: '', blinked: false, handle: 0.5, layout: localStorage.layout || 'along'});
    this.statistics = {draws: 0, milliseconds: 0};
    this.asked = {running: false, next: null};
    element.classList.add('images');
    this.build();
    this.measuring = new Measuring(app, this, this.dialogPlace);
    app.addEventListener('changed', event => this.changed(event.detail));
    app.hear(element, ['renewed'], () => this.refresh());
    app.addEventListener('selected', () => this.showPoint(app.selection));
    element.addEventListener('keydown', event => this.key(event));
    new ResizeObserver(() => this.isWhole || !this.fitted() ? this.whole() : this.request()).observe(this.row);
    this.opening = this.open().then(() => this.showPoint(app.selection));
  }

  build() {
    const mark = (key, words, checked, act) => {
      this.shown[key] = checked;
      return check(words, checked, on => { this.shown[key] = on; act(); }, {className: `mark-${key}`});
    };
    const choice = (ariaLabel, pairs, act) => make('select', {ariaLabel, title: ariaLabel, onchange: event => act(event.target.value)}, ...options(pairs));
    this.layouts = choice('Direction of the lines (t)', LAYOUTS, key => this.setLayout(key));
    this.layouts.value = this.layout;
    this.comparing = choice('Compare with the second image', COMPARED, key => this.setCompare(key));
    this.swiper = make('input', {type: 'range', min: 0, max: 1, step: 0.01, className: 'swiper', title: 'Swipe ([ and ])', ariaLabel: 'Swipe'});
    this.swiper.oninput = () => this.swipe(Number(this.swiper.value));
    this.before = mark('before', 'Before the adjustment', false, () => this.ask());
    this.adder = button('Add an image', () => this.addPane(), {title: 'One more image over the same ground'});
    const tools = make('div', {className: 'image-tools', role: 'group', ariaLabel: 'Images'}, this.layouts, this.comparing, this.before, this.adder,
      button('Whole image', () => this.whole(), {title: 'Show the whole first image (0)'}),
      button('Pixels 1 : 1', () => this.zoomTo(1), {title: 'One pixel of the first image on one of the screen'}),
      button('Measure', () => this.measuring.open(), {title: 'Measure a point in these images (m)'}),
      mark('side', 'Contrast, marks, profile', true, () => { this.element.dataset.side = this.shown.side; }));
    this.factor = make('input', {type: 'number', min: 1, max: 10000, value: 20, className: 'factor', ariaLabel: 'Residuals times', oninput: () => this.request()});
    const marks = make('div', {className: 'image-marks', role: 'group', ariaLabel: 'What is drawn on the images'},
      ...SHOWN.map(one => mark(...one, () => this.request())));
    marks.querySelector('.mark-residuals').append(this.factor);
    this.row = make('div', {className: 'image-panes'});
    this.dialogPlace = make('div', {className: 'image-dialog'});
    this.contrastPlace = make('div');
    this.place = caption('Move over an image to see its ground.');
    [this.laser, this.differences] = ['', 'differences'].map(name => make('canvas',
      {className: `laser-profile ${name}`, tabIndex: 0, role: 'img', onclick: event => this.pickShot(event)}));
    this.laserWords = make('span');
    this.profile = make('div', {className: 'laser'}, make('p', {className: 'caption'}, make('b', {className: 'ink-before', textContent: '○ before'}), ' ',
      make('b', {className: 'ink-after', textContent: '■ after'}), ' the adjustment. ', this.laserWords), this.laser, this.differences);
    this.element.replaceChildren(tools, this.dialogPlace, this.row, make('div', {className: 'image-side'}, this.contrastPlace, marks, this.place), this.profile);
  }

  // --- images

  get frame() {
    return this.panes[0];
  }

  async open() {
    this.offer();
    const [first, second] = this.app.scene.images.map(one => one.name);
    if (first) await this.addPane(first);
    if (!second) return;
    const {lines, samples} = this.frame.image || {}, found = await this.app.orSay(this.ground(first, [lines / 2, samples / 2], []));
    await this.addPane(Object.keys(found?.others || {})[0] || second);
  }

  // What is known of the images of the block
  offer() {
    const {images, adjusted} = this.app.scene;
    this.sizes = new Map(images.map(one => [one.name, one]));
    for (const {chooser} of this.panes) refill(chooser, images.map(one => [one.name]));
    this.before.control.disabled = !adjusted;
    this.before.title = adjusted ? 'Nominal orientation of all images (o)' : 'Nothing has been adjusted';
  }

  async addPane(name) {
    if (this.panes.length >= MOST) return this.app.say(`At most ${MOST} images side by side.`, 'error');
    const names = this.app.scene.images.map(one => one.name), here = this.panes.map(one => one.name);
    const unseen = Object.keys(this.link?.others || {}).filter(one => !here.includes(one));
    const chosen = typeof name === 'string' ? name : unseen[0] || names.find(one => !here.includes(one)) || names[0];
    const pane = new Pane(this, chosen);
    this.panes.push(pane);
    this.row.append(pane.element);
    this.row.dataset.count = this.panes.length;
    this.adder.disabled = this.panes.length >= MOST;
    await pane.load();
    this.changedPanes();
  }

  removePane(pane) {
    if (this.panes.length < 2) return;
    pane.close();
    pane.element.remove();
    const first = this.frame === pane;
    this.panes = this.panes.filter(one => one !== pane);
    this.row.dataset.count = this.panes.length;
    this.adder.disabled = false;
    if (first) Object.assign(this, {link: null, known: null, isWhole: true});
    this.setCompare(this.panes.length < 2 ? '' : this.compare);
    this.changedPanes();
  }

  changedPanes() {
    const {lines, samples} = this.frame.image || {lines: 1, samples: 1};
    this.comparing.disabled = this.panes.length < 2;
    this.row.dataset.stacked = this.layout === 'along' && Math.max(lines, samples) > LONG * Math.min(lines, samples);
    if (this.isWhole || !this.fitted()) this.whole();
    this.ask();
    this.activate();
    this.request();
  }

  setLayout(key) {
    localStorage.layout = this.layout = this.layouts.value = key;
    this.isWhole = true;
    this.changedPanes();
  }

  // One image over the other in the first pane, or all panes side by side
  setCompare(key) {
    if (key && !this.panes[1]) return this.app.say('Add an image to compare with.', 'error');
    Object.assign(this, {compare: key, blinked: false});
    this.comparing.value = this.row.dataset.compare = key;
    this.swiper.remove();
    if (key === 'swipe') this.frame.box.append(this.swiper);
    return this.request();
  }

  swipe(share) {
    this.handle = this.swiper.value = Math.max(0, Math.min(1, share));
    this.request();
  }

  // The image that lies over a pane's own
  over(pane) {
    return this.compare && pane === this.frame && this.panes[1]?.image ? this.panes[1] : null;
  }

  // The point's measures as they are now, until all is read anew
  changed({point, measures} = {}) {
    for (const {name, image} of this.panes) {
      if (!measures || !image) continue;
      const {ties} = image, now = measures.find(one => one.image === name), columns = ['names', 'measured', 'residuals', 'sigmas', 'used', 'kinds'];
      let k = ties.names.indexOf(point);
      if (k >= 0 && !now) columns.forEach(key => ties[key].splice(k, 1));
      if (k < 0) k = ties.names.length;
      if (now) [point, [now.line, now.sample], null, now.sigma_px, true, ties.kinds[k] || 'tie'].forEach((value, c) => { ties[columns[c]][k] = value; });
      image.order = worstFirst(ties);
    }
    this.request();
  }

  async refresh() {
    this.offer();
    this.link = null;
    await Promise.all(this.panes.map(one => one.load()));
    this.changedPanes();
  }

  // --- the common view

  fitted() {
    return this.zoom > 0 && this.center && this.frame?.image;
  }

  whole() {
    const {image, canvas} = this.frame || {};
    if (!image || !canvas.clientWidth) return;
    const {lines, samples} = image, {clientWidth: width, clientHeight: height} = canvas;
    this.center = [lines / 2, samples / 2];
    const [a, b, c, d] = this.axes.map(Math.abs);
    this.zoom = 0.95 * Math.min(width / (a * samples + b * lines), height / (c * samples + d * lines));
    this.isWhole = true;
    this.link = null;
    this.ask();
    this.request();
  }

  // Canvas pixels right and down by samples and lines of the first image, at a zoom of 1: as `ofFrame` wants them
  get axes() {
    const {canvas, image} = this.frame, {east_north_m: ground, spacing_m: spacing} = this.known || {};
    if (this.layout === 'north' && ground) return [ground[0][1], ground[0][0], -ground[1][1], -ground[1][0]].map(one => one / spacing[1]);
    const shape = this.shown.shape && spacing ? spacing[0] / spacing[1] : 1;
    const lies = (image.lines * shape > image.samples) === (canvas.clientWidth > canvas.clientHeight);
    return this.layout === 'along' && lies ? [0, shape, -1, 0] : [1, 0, 0, shape];
  }

  // Where the pixels of a pane's image lie on its canvas, or on that of the first pane
  mapping(pane, canvas = pane.canvas) {
    if (!this.fitted()) return null;
    const frame = ofFrame(this.center, this.zoom, this.axes, canvas.clientWidth, canvas.clientHeight);
    if (pane === this.frame) return frame;
    if (!this.link) return null;
    const same = pane.name === this.frame.name ? {...this.link, jacobian: [[1, 0], [0, 1]]} : null;
    const other = same || this.link.others[pane.name];
    const found = other && ofOther(frame, this.link, other);
    return found && !this.shown.turned && canvas === pane.canvas ? likeFrame(found, frame) : found;
  }

  // Edges of the other images that show the ground under the cross, as they lie about it
  outlines(context, name, width, height) {
    const frame = ofFrame(this.center, this.zoom, this.axes, width, height);
    if (name !== this.frame.name) drawFrame(context, frame, this.frame.image, this.frame.name);
    for (const [other, one] of Object.entries(this.link?.others || {})) {
      const mapping = other !== name && ofOther(frame, this.link, one);
      if (mapping) drawFrame(context, mapping, this.sizes.get(other), other);
    }
  }

  // [line, sample] of the first image at the cross
  get crossPlace() {
    const pane = this.frame, {clientWidth: width, clientHeight: height} = pane.canvas;
    return this.mapping(pane).toImage(width / 2 + this.cursor[0], height / 2 + this.cursor[1]);
  }

  pan(dx, dy) {
    const {clientWidth: width, clientHeight: height} = this.frame.canvas;
    this.center = this.mapping(this.frame).toImage(width / 2 - dx, height / 2 - dy);
    this.isWhole = false;
    this.request();
  }

  // Zoom about the cross
  zoomBy(factor) {
    const least = 0.2 * Math.min(...['lines', 'samples'].map(key => 100 / this.frame.image[key])), before = this.crossPlace;
    this.zoom = Math.max(least, Math.min(64, this.zoom * factor));
    const after = this.crossPlace;
    this.center = this.center.map((one, k) => one + before[k] - after[k]);
    this.isWhole = false;
    this.request();
  }

  zoomTo(pixels) {
    if (this.fitted()) this.zoomBy(pixels / (window.devicePixelRatio || 1) / this.zoom);
  }

  moveCross(x, y) {
    this.cursor = [x, y];
    this.ask();
    this.request();
  }

  // --- the server's answers

  ground(name, place, others, before = this.shown.before) {
    const asked = new URLSearchParams({name, line: place[0], sample: place[1]});
    for (const one of others) asked.append('with', one);
    if (before) asked.append('before', 1);
    return this.app.request(`/api/image/ground?${asked}`);
  }

  // Ask for the ground under the cross: one question at a time, the last one asked is answered
  async ask() {
    if (!this.fitted() || !this.frame?.image) return;
    this.asked.next = true;
    if (this.asked.running) return;
    this.asked.running = true;
    while (this.asked.next && this.fitted()) {
      this.asked.next = false;
      const {name, image} = this.frame, cross = this.crossPlace;
      const place = [Math.max(0, Math.min(image.lines, cross[0])), Math.max(0, Math.min(image.samples, cross[1]))];
      const beside = place[0] !== cross[0] || place[1] !== cross[1];
      try {
        const found = await this.ground(name, place, this.panes.slice(1).map(one => one.name));
        if (name !== this.frame.name) continue;
        if (!found.sentence) this.link = {...found, line: place[0], sample: place[1]};
        if (!this.known && this.link) {
          this.known = this.link;
          this.ground(name, place, [], true).catch(() => {}); // the server is ready then for the first `o`
          if (this.isWhole && (this.layout === 'north' || this.shown.shape)) this.whole();
        }
        this.place.textContent = found.sentence || (beside ? 'At the edge of the first image: ' : '') + this.groundWords(found);
      } catch (error) {
        this.place.textContent = error.message;
      }
      this.request();
    }
    this.asked.running = false;
  }

  // Longitude, latitude and height, short
  position({longitude_deg: east, latitude_deg: north, height_m: height, height_sigma_m: sigma}) {
    return `${east.toFixed(6)}° E ${Math.abs(north).toFixed(6)}° ${north < 0 ? 'S' : 'N'} · ${height.toFixed(1)}${sigma === null ? '' : ` ± ${short(sigma, 2)}`} m`;
  }

  groundWords(found) {
    return `Planetocentric; height above the ellipsoid, ${found.surface}; ${found.sigmas} sigmas. `
      + `A pixel is ${short(found.spacing_m[0])} × ${short(found.spacing_m[1])} m.`;
  }

  // --- drawing

  request() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      this.draw();
    });
  }

  draw() {
    const begin = performance.now();
    for (const pane of this.panes) pane.draw(this.mapping(pane));
    this.near = this.active && nearestShot(this.active, this.mapping(this.active), this.cursor);
    if (this.near?.k !== this.drawnNear?.k || this.near?.profile !== this.drawnNear?.profile) this.drawProfile();
    this.statistics.draws += 1;
    this.statistics.milliseconds += performance.now() - begin;
  }

  // The pane that has the keyboard, or the first one; the one that blinking shows
  get active() {
    const own = this.panes.find(one => one.canvas === document.activeElement) || this.panes[0];
    return (this.blinked && this.over(own)) || own;
  }

  // Contrast and profile are those of the active pane
  activate() {
    const {contrast} = this.active || {};
    this.contrastPlace.replaceChildren(...(contrast ? [contrast.element] : []));
    contrast?.draw();
    this.drawProfile();
  }

  drawProfile() {
    this.drawnNear = this.near;
    const {image} = this.active || {};
    this.profile.hidden = !image?.shots.profiles.length;
    if (image) this.laserWords.textContent = drawLaser(this.laser, this.differences, image, this.near);
    this.laser.setAttribute('aria-label', this.laserWords.textContent);
  }

  pickShot(event) {
    const found = event.target.nearest?.(event.offsetX);
    const place = found && (found.profile.after[found.k] || found.profile.before[found.k]);
    if (place) this.centerOn(this.active, place);
  }

  // --- going to places

  // Bring a place of a pane's image to the middle
  centerOn(pane, place) {
    const mapping = this.mapping(pane);
    if (!mapping) return;
    const [x, y] = mapping.toCanvas(...place), {clientWidth: width, clientHeight: height} = pane.canvas;
    this.cursor = [0, 0];
    this.pan(width / 2 - x, height / 2 - y);
    this.ask();
  }

  // Images side by side, a position of the first one in the middle: [{image, line, sample}]
  async see(positions, point = '', most = 2) {
    await this.opening;
    if (!this.fitted()) this.whole();
    for (const [k, {image}] of positions.slice(0, most).entries()) {
      const pane = this.panes[k];
      if (!pane) await this.addPane(image);
      else if (pane.name !== image) await pane.choose(pane.chooser.value = image);
    }
    const [{line, sample}] = positions;
    if (line !== undefined) {
      this.zoomTo(1);
      this.centerOn(this.frame, [line, sample]);
    }
    const twin = this.panes.find(({name}, k) => this.panes.findIndex(one => one.name === name) < k);
    const other = twin && this.app.scene.images.find(one => this.panes.every(pane => pane.name !== one.name));
    if (other) await twin.choose(twin.chooser.value = other.name);
    this.showPoint(point);
    this.frame.canvas.focus({preventScroll: true});
    return this;
  }

  // A point in two of its images, of which one can be named
  async lookAt(point, image) {
    const {rays} = await this.app.request(`/api/point?${new URLSearchParams({name: point})}`);
    if (!rays.length) return this.app.say(`${point} is measured in no image.`, 'error');
    return this.see([...rays].sort((a, b) => (b.image === image) - (a.image === image)), point);
  }

  showPoint(name) {
    if (!name) return this.request();
    for (const pane of this.panes) {
      const k = pane.image ? pane.image.ties.names.indexOf(name) : -1;
      if (k < 0 || !this.mapping(pane)) continue;
      if (this.element.offsetParent === null || !pane.near(pane.image.ties.measured[k]))
        this.centerOn(pane, pane.image.ties.measured[k]);
      break;
    }
    this.request();
  }

  // The tie of the active image with the next smaller (or larger) residual in units of its sigma
  nextTie(step) {
    const {ties, order} = this.active.image || {order: []};
    if (!order.length) return this.app.say('No tie is measured in this image.', 'error');
    const now = order.findIndex(k => ties.names[k] === this.app.selection);
    const k = order[(now < 0 ? (step > 0 ? 0 : order.length - 1) : now + step + order.length) % order.length];
    this.centerOn(this.active, ties.measured[k]);
    this.choose(this.active, k);
  }

  choose(pane, k) {
    this.app.select(pane.image.ties.names[k]);
    this.app.say(pane.tieWords(k));
  }

  // --- keyboard

  key(event) {
    if (event.target.matches('input:not([type=checkbox]), select, textarea') || withModifier(event) || !this.fitted()) return;
    const act = this.acts(event)[event.key];
    if (!act) return;
    event.preventDefault();
    event.stopPropagation();
    act();
  }

  // What keys do
  acts({target, shiftKey}) {
    const next = LAYOUTS[(LAYOUTS.findIndex(([key]) => key === this.layout) + 1) % LAYOUTS.length][0], step = shiftKey ? this.zoom : STEP;
    return {
      ArrowLeft: () => this.step(step, 0), ArrowRight: () => this.step(-step, 0), ArrowUp: () => this.step(0, step), ArrowDown: () => this.step(0, -step),
      '+': () => this.zoomBy(1.25), '=': () => this.zoomBy(1.25), '-': () => this.zoomBy(0.8), 0: () => this.whole(),
      n: () => this.nextTie(1), p: () => this.nextTie(-1), m: () => this.measuring.open(),
      t: () => this.setLayout(next), o: () => this.before.control.click(),
      b: () => (this.compare === 'blink' ? this.blink() : this.setCompare('blink')), w: () => this.setCompare('swipe'), a: () => this.setCompare('red'),
      '[': () => this.swipe(this.handle - 0.02), ']': () => this.swipe(this.handle + 0.02),
      ...target.tagName === 'CANVAS' && {Enter: () => this.take(this.active)},
      ...this.compare && {Escape: () => this.setCompare('')}, ...this.measuring.running && {Escape: () => this.measuring.close()},
    };
  }

  // Pan by a key, with the cross in the middle
  step(dx, dy) {
    this.cursor = [0, 0];
    this.pan(dx, dy);
    this.ask();
  }

  blink() {
    this.blinked = !this.blinked;
    this.activate();
    this.request();
  }

  // The place at the cross of a pane: measured, or the tie there chosen
  take(own) {
    const {canvas} = own, pane = (this.blinked && this.over(own)) || own;
    const mapping = this.mapping(pane, canvas), at = [canvas.clientWidth / 2 + this.cursor[0], canvas.clientHeight / 2 + this.cursor[1]];
    if (!mapping || !pane.image) return;
    const [line, sample] = mapping.toImage(...at), tie = pane.tieNear(at);
    if (this.measuring.running) return this.measuring.take(pane, [line, sample]);
    this.app.place({image: pane.name, line, sample});
    if (tie !== null) this.choose(pane, tie);
  }
}

export {Images as Panel};
