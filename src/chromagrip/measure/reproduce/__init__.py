"""The results of the thesis beside ours."""
