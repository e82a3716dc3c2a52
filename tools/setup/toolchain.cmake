# Used only with the ROS 2 wheels in .venv (the Makefile passes it); an ordinary ROS workspace needs none of it.
# The wheels' exported targets name include directories of the machine that built them. The hook below is
# included at the end of every project() call and drops those directories from the imported targets.
set(CMAKE_PROJECT_INCLUDE "${CMAKE_CURRENT_LIST_DIR}/imported_targets.cmake")
