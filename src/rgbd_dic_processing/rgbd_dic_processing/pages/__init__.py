"""What the operator draws and sees in a browser (docs/operator.md): one small server, its pages in `static/`."""
