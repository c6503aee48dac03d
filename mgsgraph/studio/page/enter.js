// Keeps the secret of this session where pages of other ports can't read it; the address, which worked once, goes.
localStorage.secret = document.currentScript.dataset.secret;
location.replace('/');
