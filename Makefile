# Only forwards to ./run, e.g. make test ARGS='-k marker'
help demo test lint docs check-all lock:
	@./run $@ $(ARGS)

.PHONY: help demo test lint docs check-all lock
.NOTPARALLEL:
