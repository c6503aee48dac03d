// Long work on the project: one job at a time, its progress, and how it ended.

import {button, make} from './plot.js';

const WATCH = 400; // ms between two looks at a job

export class Work {
  constructor(app, element) {
    Object.assign(this, {app, element});
    app.addEventListener('opened', () => app.running && this.show(app.scene.job));
    app.addEventListener('job', () => this.show(app.scene.job));
  }

  // Begin or cancel a job, or look at it
  start(body) {
    if (body && this.starting) return undefined; // a double click
    this.starting ||= Boolean(body);
    const answer = this.app.request(body ? '/api/work' : '/api/state', body).then(({job}) => this.show(job));
    return this.app.orSay(answer).finally(() => { this.starting &&= !body; });
  }

  show(job) {
    const {app, element} = this, running = job.state === 'running', seconds = `${job.seconds.toFixed(job.seconds < 10 ? 1 : 0)} s`;
    const began = running !== this.running;
    Object.assign(this, {running});
    app.scene.job = job;
    element.hidden = false;
    element.className = job.state === 'failed' ? 'failed' : '';
    if (running && !began) this.stage.textContent = `${job.stage || 'begins'} · ${seconds}`;
    else {
      this.stage = make('span', {textContent: running ? `begins · ${seconds}` : `${job.state}, ${seconds}`});
      const end = running ? button('Cancel', () => this.start({kind: 'cancel'})) : button('Close', () => { element.hidden = true; });
      element.replaceChildren(make('strong', {textContent: job.title}), ' ', this.stage, ' ', end);
      if (!running && job.lines.length) element.append(make('pre', {tabIndex: 0, textContent: job.lines.join('\n')}));
    }
    clearTimeout(this.timer);
    if (running) this.timer = setTimeout(() => this.start(), WATCH);
    else app.notice();
    if (began || !running) app.emit('worked');
  }
}
